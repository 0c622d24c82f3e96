"""Topics that a map names: messages of any type that is installed, serialised as they come, and the numbers in them."""

import math
import re
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message

from tam_calibration.messages import point_cloud
from tam_calibration.messages.cdr import BODY, FRAME_ID, read_frame_id, read_stamp_and_doubles, stamp_of, unpack_from
from tam_calibration.messages.message_fields import LONGEST_LISTED, stamp_fields
from tam_calibration.messages.missing import in_words
from tam_calibration.messages.point_cloud import is_channel
from tam_calibration.messages.samples import expected_frames, other_frame
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT
from tam_calibration.nodes.topics import type_name
from tam_calibration.recordings.channel_map import ChannelMap, Pick, TimeColumn, read_map
from tam_calibration.recordings.choice import wanted_of
from tam_calibration.recordings.intake import in_si
from tam_calibration.recordings.tables import Table
from tam_calibration.recordings.vectors import unit_in

_Read = Callable[[bytes], tuple[int | None, Sequence[float]]]
"""Returns the stamp of a message, nanoseconds, where it has one, and the values of a stream, in their own unit."""

_ToSi = Callable[[Sequence[float]], Sequence[float]]


def _of_imu(first: int, width: int, message: bytes) -> tuple[int, Sequence[float]]:
    """Return some doubles of an IMU; NaN where the number behind them, a covariance, says that it has none."""
    stamp_ns, doubles = read_stamp_and_doubles(message, first + width + 1)
    return stamp_ns, (math.nan,) * width if doubles[-1] == -1 else doubles[first:-1]


_FAST: dict[tuple[str, tuple[str, ...]], _Read] = {
    (point_cloud.MAGNETIC_FIELD, tuple(f"magnetic_field.{axis}" for axis in "xyz")): partial(
        read_stamp_and_doubles, count=3
    ),
    (point_cloud.IMU, tuple(f"orientation.{axis}" for axis in "xyzw")): partial(_of_imu, 0, 4),
    # The attitude and its covariance precede it.
    (point_cloud.IMU, tuple(f"angular_velocity.{axis}" for axis in "xyz")): partial(_of_imu, 13, 3),
    (point_cloud.TEMPERATURE, ("temperature",)): partial(read_stamp_and_doubles, count=1),
    (point_cloud.FLOAT64, ("data",)): lambda message: (None, unpack_from(message, "d", BODY)),
}
"""Types whose numbers lie at fixed places, which is quicker than to make objects of the messages."""

_STEP = re.compile(r"\[(\d+)\]|([^.\[\]]+)")


class Input:
    """One topic, and what is read of its messages.

    Parameters
    ----------
    topic : str
        Its name, relative or absolute.
    picks : mapping of str to Pick
        What is read, by stream.
    kind : type
        Class of the messages.
    """

    def __init__(self, topic: str, picks: Mapping[str, Pick], kind: Any) -> None:
        self.topic, self.picks, self.kind = topic, picks, kind
        paths = tuple(_paths(kind()))
        self._stamp = [_getter(path) for path in stamp_fields(type_name(kind), paths)]
        self.is_stamped, self.has_header = bool(self._stamp), paths[:1] == ("header.stamp.sec",)
        self._object = lru_cache(maxsize=1)(partial(_object, kind))  # several streams read each message
        self._decoders: dict[str, tuple[_Read, _ToSi | None]] = {}

    def decoder(self, stream: str, message: bytes) -> tuple[_Read, _ToSi | None]:
        """Return what reads a stream, and what brings its values into SI, None where they are.

        Parameters
        ----------
        stream : str
            One of the picks.
        message : bytes
            By the first one it is found what the map means: it tells how long lists are.

        Raises
        ------
        InputError
            When the type lacks a field, or the unit of a field is not stated.
        """
        if stream not in self._decoders:
            self._decoders[stream] = self._make_decoder(stream, message)
        return self._decoders[stream]

    def _make_decoder(self, stream: str, message: bytes) -> tuple[_Read, _ToSi | None]:
        msgtype, pick = type_name(self.kind), self.picks[stream]
        table = Table(
            self.topic, tuple(_paths(self._object(message))), msgtype, units=point_cloud.FIELD_UNITS.get(msgtype, {})
        )
        fields = wanted_of({table.key: table}, stream, pick).fields
        read = _FAST.get((msgtype, fields)) or partial(self._read, [_getter(path) for path in fields])
        factor = TESLA_PER_FIELD_UNIT.get(unit_in(table, fields[0])) if pick.factor is None else pick.factor
        if is_channel(stream) and stream != "scalar":
            factor = 1.0
        if factor is None:
            raise InputError(
                f"the unit of {in_words(stream)} is not known: {msgtype} states none; state unit or scale_nT in the map"
            )
        to_si = None if factor == 1.0 and pick.world == "enu" else partial(_in_si, stream, factor, pick.world)
        return partial(_norm, read) if stream == "scalar" and len(fields) == 3 else read, to_si

    def _read(self, getters: Sequence[Callable[[Any], float]], message: bytes) -> tuple[int | None, Sequence[float]]:
        """Return stamp and values of a message of any type."""
        content = self._object(message)
        values = tuple(get(content) for get in getters)
        return stamp_of(*(int(get(content)) for get in self._stamp)) if self._stamp else None, values


def own_map(array: Array, scalar_type: str) -> ChannelMap:
    """Return the map of the topics of this package.

    Parameters
    ----------
    array : Array
        With the sensors and further channels that there are.
    scalar_type : str
        Type of the scalar's messages.
    """

    def pick(stream: str) -> Pick:
        topic, kind = point_cloud.topic_and_type(stream)
        return Pick(topic=topic, type=kind)

    sensors = [pick(sensor_stream(number + 1)) for number in range(array.sensor_count)]
    channels: dict[str, Any] = {name: pick(name) for name in point_cloud.CHANNEL_TOPICS}
    channels["scalar"] = replace(channels["scalar"], type=scalar_type, unit="T")
    return ChannelMap(sensors=sensors, further={name: pick(name) for name in array.further_channels}, **channels)


def map_of_topics(path: str, array: Array) -> ChannelMap:
    """Read the map of topics.

    Parameters
    ----------
    path : str
        Its file.
    array : Array
        With the sensors and further channels that there are.

    Raises
    ------
    InputError
        When it cannot be read, is the map of a file, or for another array.
    """
    found = replace(read_map(path), position=None)  # which is not read on line
    if isinstance(found.time, TimeColumn) or not all(
        pick.topic and not pick.instance for pick in found.streams.values()
    ):
        raise InputError(f"{path} is the map of a text file or log: on line each sensor and channel needs a topic")
    if len(found.sensors) != array.sensor_count:
        raise InputError(f"{path} has {len(found.sensors)} sensors, the array {array.sensor_count}")
    if unknown := sorted(found.further.keys() - set(array.further_channels)):
        raise InputError(f"{path} has {', '.join(unknown)}, which further_channels of the array file does not name")
    return found


class FrameCheck:
    """The frames that messages must have, and those of which they have others; without any, whether they change.

    Parameters
    ----------
    mounting : Mounting
        With the names of the frames.
    warn : callable
        Called with the sentence on a stream whose messages are of another frame, each time that it changes.
    """

    def __init__(self, mounting: Mounting, warn: Callable[[str], None]) -> None:
        self._expected = {stream: f"{frame}\0".encode() for stream, frame in expected_frames(mounting).items()}
        self._warn = warn
        self._first: dict[str, bytes] = {}
        self.problems: dict[str, str] = {}

    def check(self, stream: str, message: bytes) -> None:
        """Look at the frame of a serialised message.

        Parameters
        ----------
        stream : str
            That it is of, as in the synchroniser.
        message : bytes
            With a header.
        """
        expected = self._expected.get(stream)
        if expected is None:
            self._compare_with_first(stream, message)
            return
        if message.startswith(expected, FRAME_ID):
            self.problems.pop(stream, None)
            return
        problem = other_frame(stream, read_frame_id(message), expected[:-1].decode())
        if self.problems.get(stream) != problem:
            self._warn(problem)
        self.problems[stream] = problem

    def _compare_with_first(self, stream: str, message: bytes) -> None:
        """Warn once where the frame is no longer that of the first message."""
        first = self._first.get(stream)
        if first is not None and message.startswith(first, FRAME_ID):
            return
        frame = read_frame_id(message)
        if first in (None, own := f"{frame}\0".encode()):
            self._first[stream] = own
            return
        now, before = (each or "without name" for each in (frame, first[:-1].decode()))
        self._warn(f"the frame of {stream} is {now} now, and was {before}: has its driver changed?")
        self._first[stream] = b""  # with which all messages begin


def _object(kind: Any, message: bytes) -> Any:
    try:
        return deserialize_message(message, kind)
    except RuntimeError:
        raise InputError(f"a message is damaged: it is not a {type_name(kind)}") from None


def _paths(value: Any, path: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message, as ``message_fields`` does by the definition."""
    if hasattr(value, "get_fields_and_field_types"):
        for name in value.get_fields_and_field_types():
            yield from _paths(getattr(value, name), f"{path}.{name}" if path else name)
    elif isinstance(value, int | float | np.number):
        yield path
    elif isinstance(value, list | array | np.ndarray) and len(value) <= LONGEST_LISTED:
        for index, each in enumerate(value):
            yield from _paths(each, f"{path}[{index}]")


def _getter(path: str) -> Callable[[Any], float]:
    """Return what returns the number at a path of a message; NaN where a list is shorter."""
    steps = [int(index) if index else name for index, name in _STEP.findall(path)]

    def get(value: Any) -> float:
        try:
            for step in steps:
                value = value[step] if isinstance(step, int) else getattr(value, step)
        except IndexError:
            return math.nan
        return float(value)

    return get


def _norm(read: _Read, message: bytes) -> tuple[int | None, Sequence[float]]:
    stamp_ns, values = read(message)
    return stamp_ns, (math.sqrt(sum(value * value for value in values)),)


def _in_si(stream: str, factor: float, world: str, values: Sequence[float]) -> Sequence[float]:
    si: list[float] = in_si(stream, np.array(values), factor, world).tolist()
    return si
