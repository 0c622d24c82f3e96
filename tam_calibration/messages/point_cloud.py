"""The topics: their names and types, and the rows of the point clouds and matrices on them, without any ROS import.

A cloud contains one row (height and width 1) of little-endian float64 fields that follow each other without gaps.
The header's stamp is the exact time of a row.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import LARGEST, SHORTEST_ATTITUDE, largest_of
from tam_calibration.model.recording import (
    ATTITUDE_COLUMNS,
    CHANNELS,
    POSITION_COLUMNS,
    RATE_COLUMNS,
    Recording,
    is_further,
    reading_columns,
    require_further,
    topic_of,
)
from tam_calibration.model.units import FloatArray

FRAME_ID = "tam_array"
"""Default frame of everything that is corrected: the array frame."""

FLOAT64_SIZE = np.dtype(np.float64).itemsize

CHANNEL_COLUMNS = {
    "scalar": ("scalar_T",),
    "temperature": ("temperature_C",),
    "current": ("current_A",),
    "attitude": ATTITUDE_COLUMNS,
    "gyroscope": RATE_COLUMNS,
    "position": POSITION_COLUMNS,
}
"""Columns of the channels recorded with the sensors, in their order in a sample; those of further channels follow."""

_NAMES = dict(zip(CHANNEL_COLUMNS, CHANNELS, strict=True))
"""Names of these channels in a `Recording`."""


def columns_of(channel: str) -> tuple[str, ...]:
    """Return the columns of a channel; a further one is its own."""
    return CHANNEL_COLUMNS.get(channel, (channel,))


def is_channel(stream: str) -> bool:
    """Whether a stream is a channel recorded with the sensors, or a further one."""
    return stream in CHANNEL_COLUMNS or is_further(stream)


FIELD_GRADIENT_COLUMNS = (*OUTPUT_NAMES, *(f"{name}_standard_error" for name in OUTPUT_NAMES))
"""Columns of ``field_gradient``: outputs in T and T/m, then their standard errors."""

SOURCE_COLUMNS = (
    *(f"{axis}_m" for axis in "xyz"),
    *(f"position_covariance_{pair}_m2" for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
    *(f"moment_{axis}_Am2" for axis in "xyz"),
    *(f"moment_covariance_{pair}_A2m4" for pair in ("xx", "xy", "xz", "yy", "yz", "zz")),
    "status",
)
"""Columns of ``source_estimate``: position and moment with their covariances; NaN where ``status`` is not 0."""

GRADIENT_ROW_MAJOR = (3, 4, 5, 4, 6, 7, 5, 7, 8)
"""Positions among the nine outputs of the 3 × 3 gradient, row by row."""

GRADIENT_DIMENSIONS = (("row", 3, 9), ("column", 3, 3))
"""Label, size and stride of the two dimensions of the ``gradient`` message."""


def field_offsets(columns: Sequence[str]) -> list[tuple[str, int]]:
    """Return name and byte offset of each field of a row."""
    return [(name, FLOAT64_SIZE * index) for index, name in enumerate(columns)]


def center_covariance(standard_errors: FloatArray) -> FloatArray:
    """Return row-major (…, 9) covariances of the centre vector, T², of the (…, 9) standard errors of the outputs."""
    covariance = np.zeros(standard_errors.shape)
    covariance[..., ::4] = standard_errors[..., :3] ** 2
    return covariance


@dataclass(frozen=True)
class SampleLayout:
    """The columns of one synchronised sample: ``time_s``, 3K readings, then the channels that there are.

    Parameters
    ----------
    sensor_count : int
        Number of sensors K.
    channels : tuple of str
        Names of the channels that there are, in the order of `CHANNEL_COLUMNS`, then further ones by their columns; a
        value that is missing is NaN.
    """

    sensor_count: int
    channels: tuple[str, ...] = ()

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns in SI: time_s, b1x_T … bKz_T, then those of the channels, then further ones."""
        channels = (column for channel in self.channels for column in columns_of(channel))
        return ("time_s", *reading_columns(self.sensor_count), *channels)

    @classmethod
    def whole(cls, sensor_count: int, further: tuple[str, ...] = ()) -> "SampleLayout":
        """Return the layout with all channels of a node, and some further ones."""
        return cls(sensor_count, (*CHANNEL_TOPICS, *further))

    @classmethod
    def of(cls, recording: Recording) -> "SampleLayout":
        """Return the layout of the samples of a recording."""
        known = (channel for channel, name in _NAMES.items() if recording.channel(name) is not None)
        return cls(recording.sensor_count, (*known, *recording.further))

    @classmethod
    def from_columns(cls, columns: Sequence[str]) -> "SampleLayout":
        """Return the layout that has these columns.

        Raises
        ------
        InputError
            When no layout has them in this order.
        """
        sensor_count = sum(name.startswith("b") and name.endswith("x_T") for name in columns)
        known = (channel for channel, names in CHANNEL_COLUMNS.items() if names[0] in columns)
        layout = cls(sensor_count, (*known, *require_further(filter(is_further, columns))))
        if layout.columns != tuple(columns) or sensor_count == 0:
            raise InputError(f"samples must have the columns {', '.join(layout.columns)}, not {', '.join(columns)}")
        return layout

    def channel(self, rows: FloatArray, channel: str) -> FloatArray:
        """Return the (N, width) values of a channel in (N, columns) rows; NaN where there is none."""
        names = columns_of(channel)
        if channel not in self.channels:
            return np.full((len(rows), len(names)), np.nan)
        first = self.columns.index(names[0])
        return rows[:, first : first + len(names)]

    def widened(self, columns: Sequence[str], rows: FloatArray) -> FloatArray:
        """Return rows of some of the columns, by their names, with NaN in the others."""
        widened = np.full((len(rows), len(self.columns)), np.nan)
        widened[:, [self.columns.index(name) for name in columns]] = rows
        return widened

    def are_samples(self, rows: FloatArray) -> NDArray[np.bool_]:
        """Return which of (N, columns) rows a recording can hold: of sizes that can be, the readings known."""
        first, sizes = 1 + 3 * self.sensor_count, np.abs(rows)
        has_readings = (sizes[:, :first] <= self._largest[:first]).all(axis=1)
        has_attitude = ~(self.channel(sizes, "attitude") < SHORTEST_ATTITUDE).all(axis=1)
        return np.asarray(has_readings & has_attitude & ~(sizes[:, first:] > self._largest[first:]).any(axis=1))

    @cached_property
    def _largest(self) -> FloatArray:
        """(columns,) sizes that no value goes beyond."""
        channels = [largest_of(channel) for channel in self.channels for _ in columns_of(channel)]
        return np.array([LARGEST["time"], *[LARGEST["readings"]] * 3 * self.sensor_count, *channels])

    def are_partial(self, rows: FloatArray) -> NDArray[np.bool_]:
        """Return which of (N, columns) rows would be samples but for sensors that are missing, all three axes NaN."""
        last = 1 + 3 * self.sensor_count
        is_missing = np.asarray(np.isnan(rows[:, 1:last].reshape(-1, self.sensor_count, 3)).all(axis=2))
        completed = rows.copy()
        completed[:, 1:last][np.repeat(is_missing, 3, axis=1)] = 0.0
        return np.asarray(is_missing.any(axis=1) & ~is_missing.all(axis=1) & self.are_samples(completed))

    def rows(self, recording: Recording) -> FloatArray:
        """Return the (N, columns) rows of a recording."""
        readings = recording.readings_T.reshape(recording.sample_count, -1)
        values = recording.values()
        channels = [values[_NAMES.get(channel, channel)] for channel in self.channels]
        return np.column_stack([recording.time_s, readings, *channels])

    def recording(self, rows: FloatArray) -> Recording:
        """Return the recording of (N, columns) rows.

        A channel without any value is left out.

        Raises
        ------
        InputError
            When the rows are none or no recording: see `Recording`.
        """
        last = 1 + 3 * self.sensor_count
        values = {"time_s": rows[:, 0], "readings_T": rows[:, 1:last].reshape(len(rows), self.sensor_count, 3)}
        for channel in self.channels:
            first, last = last, last + len(columns_of(channel))
            if not np.isnan(rows[:, first:last]).all():
                values[_NAMES.get(channel, channel)] = rows[:, first] if last == first + 1 else rows[:, first:last]
        return Recording.of_values(values)


@lru_cache(maxsize=8)
def layout_of(columns: tuple[str, ...], sensor_count: int) -> SampleLayout:
    """Return the layout of samples of so many sensors that has these columns.

    Raises
    ------
    InputError
        When no layout has them.
    """
    layout = SampleLayout.from_columns(columns)
    if layout.sensor_count != sensor_count:
        raise InputError(f"samples of {layout.sensor_count} sensors, the array has {sensor_count}")
    return layout


MAGNETIC_FIELD, FLOAT64 = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64"
IMU, TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"

_CHANNELS = {
    "scalar": ("scalar/intensity", MAGNETIC_FIELD),
    "temperature": ("temperature", TEMPERATURE),
    "current": ("current", FLOAT64),
    "attitude": ("imu/data", IMU),
    "gyroscope": ("imu/data", IMU),
}
CHANNEL_TOPICS = {channel: topic for channel, (topic, _) in _CHANNELS.items()}


FIELD_UNITS = {MAGNETIC_FIELD: {f"magnetic_field.{axis}": "T" for axis in "xyz"}}
"""Units that definitions of messages state, by type and field."""


def sensor_topic(sensor: int) -> str:
    """Return the relative topic of a sensor, 1 to K."""
    return f"{sensor_stream(sensor)}/magnetic_field"


def topic_and_type(stream: str) -> tuple[str, str]:
    """Return the relative topic of a stream, a sensor's or a channel's, and the type that is recorded there."""
    if not is_channel(stream):
        return f"{stream}/magnetic_field", MAGNETIC_FIELD
    return _CHANNELS[stream] if stream in _CHANNELS else (topic_of(stream), FLOAT64)
