"""Play a bag onto its topics in the rhythm in which it was recorded."""

import time
from collections.abc import Iterator
from importlib import import_module
from typing import TYPE_CHECKING, Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from tam_calibration.files.bag import raw_messages
from tam_calibration.model.exceptions import InputError

if TYPE_CHECKING:
    from rosbags.rosbag2 import Reader

_CLOCK_PERIOD_NS = 10_000_000
_SENSOR_TYPE = "sensor_msgs/msg/MagneticField"

_SETTLE_S = 0.3
"""Subscribers match a publisher a little later than it matches them, and take the last messages a little later.

The player sleeps for that, and between messages: it receives nothing that could wake it, and no one tells it of either.
"""

_LONGEST_PAUSE_S = 86_400.0
"""Longest pause between messages, a day: clocks that are set make pauses of years, and a sleep has at most 292."""


class Player(Node):
    """Publishes the messages of an open bag, byte for byte.

    Parameters
    ----------
    reader : rosbags.rosbag2.Reader
        An open bag that holds messages.
    rate : float
        How many times faster than recorded.
    clock : bool
        Whether to publish the bag's time on /clock.

    Raises
    ------
    InputError
        When no message of it is of a type that is installed here.
    """

    def __init__(self, reader: "Reader", rate: float = 1.0, clock: bool = False) -> None:
        super().__init__("player")
        self._reader, self._rate = reader, rate
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if clock else None
        self.unknown_types: list[str] = []
        self._publishers_by_topic: dict[str, Any] = {}
        self._sensors: dict[str, Any] = {}
        for connection in reader.connections:
            self._advertise(connection)
        if not self._publishers_by_topic:
            raise InputError(f"{reader.path}: no message type of it is installed: {', '.join(self.unknown_types)}")

    @property
    def duration_s(self) -> float:
        """Length of the bag, seconds."""
        return float(self._reader.duration) / 1e9

    def unheard(self) -> list[str]:
        """Return the sensors' topics that nobody subscribes to."""
        return [topic for topic, publisher in self._sensors.items() if not publisher.get_subscription_count()]

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        """Wait until every sensor's topic has a subscriber; return whether that came true in time."""
        limit = time.monotonic() + timeout_s
        while self.unheard() and time.monotonic() < limit:
            time.sleep(0.02)
        time.sleep(_SETTLE_S)
        return not self.unheard()

    def play(self) -> Iterator[float]:
        """Publish every message once, yielding after each how many seconds of the bag have been played."""
        first, begin, clock_due = self._reader.start_time, time.monotonic(), 0
        for connection, stamp, data in raw_messages(self._reader, self._reader.connections):
            publisher = self._publishers_by_topic.get(connection.topic)
            if publisher is None:
                continue
            pause_s = begin + (stamp - first) / 1e9 / self._rate - time.monotonic()
            time.sleep(min(max(0.0, pause_s), _LONGEST_PAUSE_S))
            if self._clock_publisher and stamp >= clock_due:
                self._clock_publisher.publish(Clock(clock=Time(nanoseconds=stamp).to_msg()))
                clock_due = stamp + _CLOCK_PERIOD_NS
            publisher.publish(bytes(data))
            yield (stamp - first) / 1e9
        time.sleep(_SETTLE_S)

    def _advertise(self, connection: Any) -> None:
        if connection.topic == "/clock" and self._clock_publisher:
            return
        message_type = _message_type(connection.msgtype)
        if message_type is None:
            self.unknown_types.append(connection.msgtype)
            return
        publisher = self.create_publisher(message_type, connection.topic, _quality(connection.ext.offered_qos_profiles))
        self._publishers_by_topic[connection.topic] = publisher
        if connection.msgtype == _SENSOR_TYPE:
            self._sensors[connection.topic] = publisher


def _message_type(name: str) -> Any:
    package, _, message = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError):
        return None


def _quality(offered: list[Any]) -> QoSProfile:
    latched = any(profile.durability.name == "TRANSIENT_LOCAL" for profile in offered)
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
