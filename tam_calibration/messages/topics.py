"""Which topics of a bag are the streams of an array."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tam_calibration.messages.cdr import RawMessages, read_float64s, read_stamped_doubles
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.further_channels import is_further, named_by, require_further
from tam_calibration.model.units import FloatArray, IntArray

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

MAGNETIC_FIELD, FLOAT64 = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64"
IMU, TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"

CHANNEL_TOPICS = {
    "scalar": "scalar/intensity",
    "temperature": "temperature",
    "current": "current",
    "attitude": "imu/data",
}
_CHANNEL_TYPES = {
    "scalar": (MAGNETIC_FIELD, FLOAT64),
    "temperature": (TEMPERATURE,),
    "current": (FLOAT64,),
    "attitude": (IMU,),
}

_Decoder = Callable[[RawMessages], tuple[IntArray | None, FloatArray]]
"""What returns the (n,) stamps, if there are any, and the (n, columns) values of messages."""


def sensor_topic(sensor: int) -> str:
    """Return the relative topic of a sensor, 1 to K."""
    return f"{sensor_stream(sensor)}/magnetic_field"


@dataclass(frozen=True)
class StreamTopics:
    """The topics of one array in a bag.

    Parameters
    ----------
    namespace : str
        What stands before the relative names, such as ``/auv/``.
    layout : SampleLayout
        Number of sensors, and the channels that there are.
    connections : dict
        Connection of each stream of the synchroniser.
    """

    namespace: str
    layout: SampleLayout
    connections: dict[str, "Connection"]

    @property
    def scalar_is_held(self) -> bool:
        """Whether the scalar comes without stamps."""
        return self.layout.scalar and self.connections["scalar"].msgtype == FLOAT64

    def decoders(self) -> dict[str, _Decoder]:
        """Return for each stream the function that reads stamps and values of its messages."""
        decoders: dict[str, _Decoder] = dict.fromkeys(self.connections, _vectors)
        channels: dict[str, _Decoder] = {"temperature": _temperatures, "current": read_float64s, "attitude": _attitudes}
        channels |= dict.fromkeys(self.layout.further, read_float64s)
        channels["scalar"] = read_float64s if self.scalar_is_held else _norms
        return decoders | {name: decoder for name, decoder in channels.items() if name in decoders}


def find_topics(connections: Sequence["Connection"], sensor_count: int | None) -> StreamTopics:
    """Find the topics of an array by the end of their names.

    Parameters
    ----------
    connections : sequence of Connection
        The bag's.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.

    Raises
    ------
    InputError
        When a topic is missing, has another type, or there are several arrays.
    """
    namespace = _namespace(connections)
    by_topic = {connection.topic: connection for connection in connections}
    pattern = re.compile(re.escape(namespace) + sensor_topic(0).replace("0", r"(\d{1,9})"))
    highest = max(int(match[1]) for topic in by_topic if (match := pattern.fullmatch(topic)))
    if sensor_count and highest > sensor_count:
        raise InputError(f"the bag has {highest} sensors, the array {sensor_count}: use the array file of this bag")
    chosen = {}
    for sensor in range(1, (sensor_count or highest) + 1):
        chosen[sensor_stream(sensor)] = _require(by_topic, namespace + sensor_topic(sensor), (MAGNETIC_FIELD,))
    for channel, topic in CHANNEL_TOPICS.items():
        if namespace + topic in by_topic:
            chosen[channel] = _require(by_topic, namespace + topic, _CHANNEL_TYPES[channel])
    for topic in sorted(by_topic):
        if topic.startswith(namespace) and (name := named_by(topic.removeprefix(namespace))):
            chosen[name] = _require(by_topic, topic, (FLOAT64,))
    further = require_further(filter(is_further, chosen))
    channels = [channel in chosen for channel in CHANNEL_TOPICS]
    layout = SampleLayout(sensor_count or highest, *channels, further=further)
    return StreamTopics(namespace, layout, chosen)


def _namespace(connections: Sequence["Connection"]) -> str:
    first = sensor_topic(1)
    names = {topic.removesuffix(first) for topic in _topics(connections) if f"/{topic}".endswith(f"/{first}")}
    if not names:
        raise InputError(f"topic {first} is missing; the bag holds {', '.join(_topics(connections)) or 'no topic'}")
    if len(names) > 1:
        raise InputError(f"the bag holds several arrays, under {', '.join(sorted(names))}: keep the topics of one")
    return names.pop()


def _require(by_topic: dict[str, "Connection"], topic: str, types: tuple[str, ...]) -> "Connection":
    connection = by_topic.get(topic)
    if connection is None:
        raise InputError(f"topic {topic} is missing; the bag holds {', '.join(sorted(by_topic))}")
    if connection.msgtype not in types:
        raise InputError(f"topic {topic} has the type {connection.msgtype}, not {' or '.join(types)}")
    return connection


def _topics(connections: Sequence["Connection"]) -> list[str]:
    return sorted({connection.topic for connection in connections})


def _vectors(messages: RawMessages) -> tuple[IntArray, FloatArray]:
    return read_stamped_doubles(messages, 3)


def _norms(messages: RawMessages) -> tuple[IntArray, FloatArray]:
    stamps, vectors = read_stamped_doubles(messages, 3)
    return stamps, np.sqrt((vectors**2).sum(axis=1, keepdims=True))


def _temperatures(messages: RawMessages) -> tuple[IntArray, FloatArray]:
    return read_stamped_doubles(messages, 1)


def _attitudes(messages: RawMessages) -> tuple[IntArray, FloatArray]:
    """Return the quaternions; NaN where the IMU says that it has none."""
    stamps, doubles = read_stamped_doubles(messages, 13)
    has_none = (doubles[:, 4] == -1) | ~doubles[:, :4].any(axis=1)
    return stamps, np.where(has_none[:, None], np.nan, doubles[:, :4])
