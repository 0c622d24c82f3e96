"""The data of one run, checked, what the fits need of any source of samples, and its table of pandas or xarray.

Interpolation correlates the white noise of sensors with separate clocks (``InterpolatedNoise``). pandas and xarray are
not loaded before a table is asked for.

A further channel is the current of a circuit, or what an actuator does. Its name is that of a column, and implies the
topic: ``current_2_A``, the second current, is ``currents/current_2``, and ``actuator_rudder`` is ``actuators/rudder``:
an angle, a speed or a power in whatever unit. The first current is the channel ``current_A`` of old.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, cast

import numpy as np

from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.limits import LARGEST, LEAST_SPREAD_T, SHORTEST_ATTITUDE
from tam_calibration.model.units import FloatArray

if TYPE_CHECKING:
    import pandas
    import xarray


_COLUMN = re.compile(r"current_(?:[2-9]|[1-9]\d)_A|actuator_[a-z][a-z0-9_]{0,40}")


def is_further(name: str) -> bool:
    """Whether a name is that of a further channel."""
    return _COLUMN.fullmatch(name) is not None


def unit_of(name: str) -> str:
    """Return the unit of a further channel: A of a current, 1 of an actuator."""
    return "A" if name.startswith("current") else "1"


def topic_of(name: str) -> str:
    """Return the relative topic of a further channel, messages of which hold one number."""
    if name.startswith("current"):
        return f"currents/{name.removesuffix('_A')}"
    return f"actuators/{name.removeprefix('actuator_')}"


def named_by(topic: str) -> str | None:
    """Return the name of the further channel with a relative topic; None where it is another topic."""
    kind, _, name = topic.partition("/")
    column = {"currents": f"{name}_A", "actuators": f"actuator_{name}"}.get(kind, "")
    return column if is_further(column) else None


def require_further(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of further channels, each once, in the order of columns.

    Raises
    ------
    InputError
        When one is none.
    """
    given = list(names)
    for name in given:
        if not is_further(name):
            raise InputError(
                f"{quoted(name)} is no further channel: one is named current_2_A to current_99_A, or actuator_ and a "
                "name in small letters"
            )
    return tuple(sorted(set(given), key=lambda name: (not name.startswith("current"), len(name), name)))


def channel_in_words(name: str) -> str:
    """Return a channel as sentences name it: "current" of current_A, and a further one by its column."""
    if name == "angular_velocity_rad_s":
        return "gyroscope"
    return name if is_further(name) else name.partition("_")[0]


ATTITUDE_COLUMNS = ("qx", "qy", "qz", "qw")
"""Columns of the attitude in a table."""

RATE_COLUMNS = ("wx_rad_s", "wy_rad_s", "wz_rad_s")
"""Columns of the angular velocity in a table."""

POSITION_COLUMNS = ("x_m", "y_m", "z_m")
"""Columns of the position in a table; any other channel is one column of its own name."""

_OF_VECTORS = {"attitude": ATTITUDE_COLUMNS, "angular_velocity_rad_s": RATE_COLUMNS, "position_m": POSITION_COLUMNS}

_TIME = ("time_s",)

_VARIABLES = {
    "readings_T": ("T", ("time_s", "sensor", "axis")),
    "scalar_T": ("T", _TIME),
    "temperature_C": ("degC", _TIME),
    "current_A": ("A", _TIME),
    "attitude": ("1", ("time_s", "quaternion")),
    "angular_velocity_rad_s": ("rad/s", ("time_s", "axis")),
    "position_m": ("m", ("time_s", "axis")),
}
"""Attribute ``units`` and dimensions of each variable of a dataset."""

_COMPONENTS = {"axis": ["x", "y", "z"], "quaternion": ["x", "y", "z", "w"]}
"""Labels of the dimensions whose order has a meaning."""


def reading_columns(sensor_count: int) -> list[str]:
    """Return the columns of the readings of so many sensors: b1x_T, b1y_T, b1z_T, b2x_T and so on."""
    return [f"b{sensor}{axis}_T" for sensor in range(1, sensor_count + 1) for axis in "xyz"]


def _variable(name: str) -> tuple[str, tuple[str, ...]]:
    """Return unit and dimensions of a variable; a further channel is one number for each time."""
    return _VARIABLES[name] if name in _VARIABLES else (unit_of(name), _TIME)


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise InputError(f"{name} is not installed: pip install 'tam_calibration[notebook]'") from None


LAGS = 8
"""Samples after which nothing is left of the correlation: five readings take less at seven tenths of the rate."""


@dataclass(frozen=True, eq=False)
class InterpolatedNoise:
    """The correlation of the noise of K sensors from sample to sample that interpolation makes; its size is kept.

    Parameters
    ----------
    correlation : (K, LAGS) array
        Of samples that lie so many apart.
    readings_per_sample : (K,) array
        Number of readings of a sensor from one sample to the next.
    """

    correlation: FloatArray
    readings_per_sample: FloatArray

    def spectrum(self, frequency: FloatArray) -> FloatArray:
        """Return the power (K, F) of white noise of variance one at frequencies (F,), cycles a sample."""
        turns = np.cos(2 * np.pi * np.outer(np.arange(1, LAGS + 1), frequency))
        # Part of white noise that is left at any frequency, at least: between readings at even steps it is 0.08.
        return np.asarray(np.maximum(1 + 2 * self.correlation @ turns, 0.05))


CHANNELS = ("scalar_T", "temperature_C", "current_A", "attitude", "angular_velocity_rad_s", "position_m")
"""Channels that may be recorded with the sensors; a channel of NaN only is absent."""

COMPONENTS = {name: len(columns) for name, columns in _OF_VECTORS.items()}
"""Numbers of a value of each channel that has more than one; one NaN among them makes all NaN."""

BLOCK = 16_384
"""Samples that are worked on at once: what is worked out of them stays in the processor's cache."""

SKETCH = 100_000
"""Samples at most that are looked at where more would not change the judgement."""


FEWEST_SAMPLES = 9
"""An ellipsoid has nine parameters, and each sample gives one intensity. Twice as many let one half check the other."""

MOST_SENSORS = 64
"""Of an array: the covariance of their errors is then a table of 768 by 768 numbers."""


def require_sensor_count(count: int) -> None:
    """Check that so many sensors are not too many for one array.

    Raises
    ------
    InputError
        When they are.
    """
    if count > MOST_SENSORS:
        raise InputError(f"there are {count} sensors, and an array has at most {MOST_SENSORS}")


class Block(NamedTuple):
    """Some samples that follow each other, as in ``Recording``; no scalar where the complete run has none."""

    time_s: FloatArray
    readings_T: FloatArray
    scalar_T: FloatArray | None


class SampleSource(Protocol):
    """The samples of one run, in memory or on disk: a ``Recording``, or what is read again for every pass."""

    @property
    def sample_count(self) -> int:
        """Number of samples N."""

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""

    @property
    def scalar_count(self) -> int | None:
        """Number of samples with a scalar reading; None for a run without scalar magnetometer."""

    @property
    def time_span_s(self) -> tuple[float, float]:
        """First and last time stamp, seconds."""

    def blocks(self) -> Iterator[Block]:
        """Yield all samples in the order of time, ``BLOCK`` at once but for the last."""

    def thinned(self, most: int) -> "Recording":
        """Return every n-th sample, so that there are at most so many."""

    @property
    def interpolated_noise(self) -> InterpolatedNoise | None:
        """Effect of interpolation on their noise; None if no reading was interpolated."""

    def with_noise(self, noise: InterpolatedNoise) -> "SampleSource":
        """Return the same samples with what interpolation made of their noise."""

    def take(self, index: np.ndarray) -> "SampleSource":
        """Return the samples that a mask (N,) selects."""

    def whole(self) -> "Recording":
        """Return all samples in memory."""


@dataclass(frozen=True, eq=False)
class Recording:
    """N simultaneous samples of K tri-axial sensors and further channels.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, strictly increasing, seconds.
    readings_T : (N, K, 3) array
        Raw readings of the sensors along their own axes x, y, z, tesla.
    scalar_T : (N,) array, optional
        Intensity from the scalar magnetometer, tesla; NaN if missing.
    temperature_C : (N,) array, optional
        Temperature, degrees Celsius; NaN if missing.
    current_A : (N,) array, optional
        Current that may disturb the sensors, ampere; NaN if missing.
    attitude : (N, 4) array, optional
        Quaternion x, y, z, w that turns vectors of the array frame into the world's; NaN if missing. One NaN makes all
        four components NaN.
    further : mapping of str to (N,) array
        Further currents and actuators by their names, see ``require_further``; NaN if missing.
    interpolated_noise : InterpolatedNoise, optional
        Effect of interpolation on the sensors' noise; None if no reading was interpolated.
    angular_velocity_rad_s : (N, 3) array, optional
        Angular velocity of the array against the world, in the array frame, from a gyroscope, rad/s; NaN if missing.
    position_m : (N, 3) array, optional
        Place of the array's centre in the attitude's world, from navigation, metres; NaN if missing.

    Raises
    ------
    InputError
        When a shape is wrong, a required value is not finite, a value is implausible (`limits.LARGEST`), or time
        does not increase.

    Examples
    --------
    >>> import numpy as np
    >>> from tam_calibration import Recording
    >>> readings_T = np.full((3, 4, 3), 30e-6)  # three samples of four sensors
    >>> recording = Recording(np.array([0.0, 0.1, 0.2]), readings_T, scalar_T=np.full(3, 52e-6))
    >>> recording.sample_count, recording.sensor_count, recording.time_span_s
    (3, 4, (0.0, 0.2))
    """

    time_s: FloatArray
    readings_T: FloatArray
    scalar_T: FloatArray | None = None
    temperature_C: FloatArray | None = None
    current_A: FloatArray | None = None
    attitude: FloatArray | None = None
    further: Mapping[str, FloatArray] = field(default_factory=dict)
    interpolated_noise: InterpolatedNoise | None = None
    angular_velocity_rad_s: FloatArray | None = None
    position_m: FloatArray | None = None

    def __post_init__(self) -> None:
        """Check shapes, finiteness and the order of time."""
        for name in _FIELDS:
            value = getattr(self, name)
            if value is not None:
                array = np.asarray(value, dtype=float)
                if name in COMPONENTS and array.ndim:
                    array = np.where(np.isnan(array).any(axis=-1, keepdims=True), np.nan, array)
                is_absent = name in CHANNELS and bool(np.isnan(array).all())
                object.__setattr__(self, name, None if is_absent else array)
        further = {name: np.asarray(self.further[name], dtype=float) for name in require_further(self.further)}
        present = {name: values for name, values in further.items() if not np.isnan(values).all()}
        object.__setattr__(self, "further", present)
        if self.readings_T.ndim != 3 or self.readings_T.shape[2] != 3 or self.readings_T.shape[1] < 1:
            raise InputError(f"readings must have the shape (samples, sensors, 3), not {self.readings_T.shape}")
        require_sensor_count(self.sensor_count)
        self._check_shapes()
        if self.sample_count == 0:
            raise InputError("the recording contains no sample")
        self._check_sizes()
        self._check_attitude()
        self._check_time()

    def _check_shapes(self) -> None:
        for name, value in self.values().items():
            shape = (self.sample_count, *((COMPONENTS[name],) if name in COMPONENTS else ()))
            if name != "readings_T" and value.shape != shape:
                raise InputError(f"{name} must have the shape {shape} to match the readings, not {value.shape}")

    def _check_sizes(self) -> None:
        for name, value in self.values().items():
            is_channel, largest = name not in ("time_s", "readings_T"), LARGEST[name.partition("_")[0]]
            bad = np.abs(value) > largest if is_channel else ~(np.abs(value) <= largest)
            if bad.any():
                index = np.argwhere(bad)[0]
                where = f"sensor {index[1] + 1} axis {'xyz'[index[2]]}" if name == "readings_T" else name
                bad_samples, first = np.flatnonzero(bad.reshape(len(bad), -1).any(axis=1)), value[tuple(index)]
                first_s, last_s = self.time_s[bad_samples[[0, -1]]].tolist()
                has_times = np.isfinite([first_s, last_s]).all()
                span = f", between {first_s:.12g} and {last_s:.12g} s" if has_times else ""
                kind, remedy = f"{'' if is_channel else 'NaN or '}infinite values", "leave those samples out"
                if np.isfinite(first):
                    kind, remedy = f"values beyond {largest:g}", f"{first:g} is of another unit, or damage"
                raise InputError(
                    f"{len(bad_samples)} of {self.sample_count} samples hold {kind}, first {where} in sample "
                    f"{index[0] + 1}{span}: {remedy}"
                )

    def _check_attitude(self) -> None:
        if self.attitude is None:
            return
        is_zero = (np.abs(self.attitude) < SHORTEST_ATTITUDE).all(axis=1)
        if is_zero.any():
            raise InputError(
                f"{int(is_zero.sum())} of {self.sample_count} attitudes are four zeros, first in sample "
                f"{int(np.argmax(is_zero)) + 1}, which is no attitude: leave empty what is not known"
            )

    def _check_time(self) -> None:
        step = np.diff(self.time_s)
        if (step > 0).all():
            return
        first = int(np.argmax(step <= 0))
        kind = "repeats" if step[first] == 0 else "goes backwards"
        raise InputError(
            f"time {kind} at sample {first + 2}: after {self.time_s[first]:.6f} s comes {self.time_s[first + 1]:.6f} s "
            f"({int((step <= 0).sum())} such places): times must increase; take one run of a simulator that was reset"
        )

    @property
    def sample_count(self) -> int:
        """Number of samples N."""
        return len(self.readings_T)

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return int(self.readings_T.shape[1])

    @property
    def scalar_count(self) -> int | None:
        """Number of samples with a scalar reading; None for a run without scalar magnetometer."""
        return None if self.scalar_T is None else int(np.isfinite(self.scalar_T).sum())

    @property
    def time_span_s(self) -> tuple[float, float]:
        """First and last time stamp, seconds."""
        return float(self.time_s[0]), float(self.time_s[-1])

    def blocks(self) -> Iterator[Block]:
        """Yield all samples in the order of time, ``BLOCK`` at once but for the last.

        Yields
        ------
        Block
            Times (n,) in seconds, readings (n, K, 3) and scalar (n,) in tesla.
        """
        for start in range(0, self.sample_count, BLOCK):
            part = slice(start, start + BLOCK)
            scalar = None if self.scalar_T is None else self.scalar_T[part]
            yield Block(self.time_s[part], self.readings_T[part], scalar)

    def thinned(self, most: int) -> "Recording":
        """Return every n-th sample, so that there are at most so many.

        Parameters
        ----------
        most : int
            The number of samples that there may be.

        Returns
        -------
        Recording
            The first sample and every n-th after it, with the smallest such n; itself where it is short enough.
        """
        stride = -(-self.sample_count // most)
        return self if stride == 1 else self.take(slice(None, None, stride))

    def whole(self) -> "Recording":
        """Return the recording itself, which is in memory.

        Returns
        -------
        Recording
            Itself.
        """
        return self

    def with_noise(self, noise: InterpolatedNoise) -> "Recording":
        """Return the same samples with what interpolation made of their noise.

        Parameters
        ----------
        noise : InterpolatedNoise
            Of the K sensors.

        Returns
        -------
        Recording
            Of the same values.
        """
        return replace(self, interpolated_noise=noise)

    def take(self, index: slice | np.ndarray) -> "Recording":
        """Return the recording of some of the samples.

        Parameters
        ----------
        index : slice or array
            A slice, a mask (N,) or increasing positions.

        Returns
        -------
        Recording
            With every channel that has a value left.

        Raises
        ------
        InputError
            When no sample is selected, or the order of time is not kept.
        """
        own = {name: value[index] for name in _FIELDS if (value := getattr(self, name)) is not None}
        return replace(self, **own, further={name: value[index] for name, value in self.further.items()})

    def channel(self, name: str) -> FloatArray | None:
        """Return the values of a channel, or of a further one, by its name; None where it was not recorded.

        Parameters
        ----------
        name : str
            One of ``CHANNELS``, or of ``further``.

        Returns
        -------
        (N,), (N, 3) or (N, 4) array, or None
            As in the recording.
        """
        return cast("FloatArray | None", getattr(self, name)) if name in CHANNELS else self.further.get(name)

    @classmethod
    def of_values(cls, values: Mapping[str, FloatArray]) -> "Recording":
        """Make a recording of its values by their names, further channels among them.

        Parameters
        ----------
        values : mapping of str to array
            The fields that are there, and each further channel, as in the class.

        Raises
        ------
        InputError
            As the class does, and when a name is not known.
        """
        own: dict[str, Any] = {name: value for name, value in values.items() if name in _FIELDS}
        return cls(**own, further={name: value for name, value in values.items() if name not in _FIELDS})

    def values(self) -> dict[str, FloatArray]:
        """Return what there is by name, further channels among it, as ``of_values`` takes it.

        Returns
        -------
        dict of str to array
            ``time_s``, ``readings_T`` and the channels in the order of their columns.
        """
        own = {name: value for name in _FIELDS if (value := getattr(self, name)) is not None}
        return own | dict(self.further)

    def to_pandas(self) -> "pandas.DataFrame":
        """Return the samples as a table, one row each.

        Returns
        -------
        pandas.DataFrame
            Index ``time_s``; columns as in a CSV file but SI: b1x_T, b1y_T, b1z_T … bKz_T along the sensors' own axes.
            Then, if recorded, scalar_T, temperature_C, current_A, qx, qy, qz, qw, wx_rad_s, wy_rad_s, wz_rad_s, x_m,
            y_m, z_m, and the further channels.

        Raises
        ------
        InputError
            When pandas is not installed.

        Examples
        --------
        >>> from tam_calibration import read_scenario, simulate
        >>> frame = simulate(read_scenario("wu_table_1")).recording.to_pandas()
        >>> frame.shape
        (360, 13)
        >>> list(frame.columns[:4])
        ['b1x_T', 'b1y_T', 'b1z_T', 'b2x_T']
        """
        table = _library("pandas")
        readings = self.readings_T.reshape(self.sample_count, -1)
        columns = dict(zip(reading_columns(self.sensor_count), readings.T, strict=True))
        for name, channel in self.values().items():
            if name in _OF_VECTORS:
                columns |= zip(_OF_VECTORS[name], channel.T, strict=True)
            elif name not in ("time_s", "readings_T"):
                columns[name] = channel
        return table.DataFrame(columns, index=table.Index(self.time_s, name="time_s"))

    @classmethod
    def from_pandas(cls, frame: "pandas.DataFrame", map: Any = None) -> "Recording":
        """Make a recording of a table, as ``to_pandas`` returns it or with any columns and time.

        Parameters
        ----------
        frame : pandas.DataFrame
            Its columns in any order; the time is the index or a column: numbers, datetimes or timedeltas. Rows that
            lack a sensor are left out; what is missing in a channel is NaN.
        map : ChannelMap, mapping, str or Path, optional
            Which columns are what, as of ``read_recording``; by default the choice is made from their names.

        Returns
        -------
        Recording
            Of its rows.

        Raises
        ------
        InputError
            When a column is missing or not of numbers, the choice is ambiguous, or the values make no recording.

        Examples
        --------
        >>> from tam_calibration import Recording, read_scenario, simulate
        >>> frame = simulate(read_scenario("wu_table_1")).recording.to_pandas()
        >>> Recording.from_pandas(frame[frame.index < 100]).readings_T.shape
        (100, 4, 3)
        """
        # The readers of files know tables too; their room is above the model, which does not import it.
        made: Recording = import_module("tam_calibration.recordings.recording_file").recording_of_frame(frame, map)
        return made

    def to_xarray(self) -> "xarray.Dataset":
        """Return the samples as a dataset with labelled dimensions.

        Returns
        -------
        xarray.Dataset
            Variables with the names of the fields: ``readings_T`` over ``time_s``, ``sensor`` (1 to K) and ``axis``
            (x, y, z of the sensor). ``attitude`` is over ``time_s`` and ``quaternion`` (x, y, z, w),
            ``angular_velocity_rad_s`` and ``position_m`` over ``time_s`` and ``axis``, the others over ``time_s``. Each
            has its unit as the attribute ``units``.

        Raises
        ------
        InputError
            When xarray is not installed.

        Examples
        --------
        >>> from tam_calibration import read_scenario, simulate
        >>> dataset = simulate(read_scenario("wu_table_1")).recording.to_xarray()
        >>> dataset["readings_T"].sel(sensor=2, axis="z").shape
        (360,)
        >>> dataset["scalar_T"].attrs["units"]
        'T'
        """
        values = self.values()
        time = ("time_s", values.pop("time_s"), {"units": "s"})
        variables = {}
        for name, value in values.items():
            unit, dimensions = _variable(name)
            variables[name] = (dimensions, value, {"units": unit})
        used = {dimension for dimensions, _, _ in variables.values() for dimension in dimensions}
        labels = {name: label for name, label in _COMPONENTS.items() if name in used}
        coordinates = {"time_s": time, "sensor": np.arange(1, self.sensor_count + 1), **labels}
        dataset: xarray.Dataset = _library("xarray").Dataset(variables, coordinates)
        return dataset

    @classmethod
    def from_xarray(cls, dataset: "xarray.Dataset") -> "Recording":
        """Make a recording of a dataset as ``to_xarray`` returns it.

        Parameters
        ----------
        dataset : xarray.Dataset
            Its dimensions and the labels of ``axis`` and ``quaternion`` in any order, its sensors in that of the array.

        Returns
        -------
        Recording
            Of its samples.

        Raises
        ------
        InputError
            When a variable, dimension or label is missing, a variable is not known or has another unit, or the values
            make no recording.

        Examples
        --------
        >>> from tam_calibration import Recording, read_scenario, simulate
        >>> dataset = simulate(read_scenario("wu_table_1")).recording.to_xarray()
        >>> Recording.from_xarray(dataset.isel(time_s=slice(100))).readings_T.shape
        (100, 4, 3)
        """
        if others := [name for name in dataset.data_vars if name not in _VARIABLES and not is_further(str(name))]:
            raise InputError(f"variable {others[0]!r} is not known: a recording has {', '.join(_VARIABLES)}")
        if missing := [name for name in ("time_s", "readings_T") if name not in dataset.variables]:
            raise InputError(
                f"variable {missing[0]!r} is missing: a recording has {', '.join(('time_s', *_VARIABLES))}"
            )
        values = {"time_s": np.asarray(dataset["time_s"], dtype=float)}
        for name in map(str, dataset.data_vars):
            variable = dataset[name]
            own_unit, dimensions = _variable(name)
            if (unit := variable.attrs.get("units", own_unit)) != own_unit:
                raise InputError(f"variable {name} is in {unit!r} and must be in {own_unit!r}")
            try:
                chosen = {each: _COMPONENTS[each] for each in dimensions if each in _COMPONENTS}
                values[name] = np.asarray(variable.transpose(*dimensions).sel(chosen), dtype=float)
            except (KeyError, ValueError) as problem:
                raise InputError(f"variable {name} must have the dimensions {dimensions}: {problem}") from None
        return cls.of_values(values)

    def check_plausible(self, field: FieldBounds = EARTH_FIELD) -> None:
        """Check that readings and scalar can be those of a field in tesla that the array was turned in.

        Parameters
        ----------
        field : FieldBounds
            What its intensity can be.

        Raises
        ------
        InputError
            When a sensor's axis is constant, or sizes betray another unit than the one stated.
        """
        spread = np.ptp(self.readings_T, axis=0)
        if self.sample_count > 1 and (spread < LEAST_SPREAD_T).any():
            sensor, axis = np.argwhere(spread < LEAST_SPREAD_T)[0]
            raise InputError(
                f"sensor {sensor + 1} axis {'xyz'[axis]} reads the same value in all {self.sample_count} samples: "
                "it is not connected, or was not turned"
            )
        self.check_units(field)

    def check_units(self, field: FieldBounds = EARTH_FIELD) -> None:
        """Check that the sizes of readings and scalar are those of a field in tesla.

        Parameters
        ----------
        field : FieldBounds
            What its intensity can be.

        Raises
        ------
        InputError
            When they betray another unit than the one stated.
        """
        if self.scalar_T is not None:
            field.require_intensity(float(np.nanmedian(self.scalar_T)))
        field.require_readings(np.median(np.linalg.norm(self.readings_T, axis=2), axis=0))


_FIELDS = tuple(each.name for each in fields(Recording) if each.name not in ("further", "interpolated_noise"))
"""Names of the values that have a field of their own."""
