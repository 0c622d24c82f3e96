"""Play a recording onto topics in the rhythm in which it was recorded."""

import time
from collections.abc import Iterator
from typing import Any

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from tam_calibration.messages.point_cloud import MAGNETIC_FIELD
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.message_types import message_class
from tam_calibration.nodes.playback import Playback

_CLOCK_PERIOD_NS = 10_000_000

_SETTLE_S = 0.3
"""Subscribers match a publisher a little later than it matches them, and take the last messages a little later.

The player sleeps for that, and between messages: it receives nothing that could wake it, and no one tells it of either.
"""

_LONGEST_PAUSE_S = 86_400.0
"""Longest pause between messages, a day: clocks that are set make pauses of years, and a sleep has at most 292."""


class Player(Node):
    """Publishes serialised messages.

    Parameters
    ----------
    playback : Playback
        The messages of an open recording.
    rate : float
        How many times faster than recorded.
    clock : bool
        Whether to publish the recording's time on /clock.

    Raises
    ------
    InputError
        When no message of it is of a type that is installed here.
    """

    def __init__(self, playback: Playback, rate: float = 1.0, clock: bool = False) -> None:
        super().__init__("player")
        self.playback, self._rate = playback, rate
        self._clock_publisher = self.create_publisher(Clock, "/clock", 10) if clock else None
        self.unknown_types: list[str] = []
        self._publishers_by_topic: dict[str, Any] = {}
        self._sensors: dict[str, Any] = {}
        for topic, (msgtype, is_latched) in playback.types.items():
            self._advertise(topic, msgtype, is_latched)
        if not self._publishers_by_topic:
            raise InputError(f"{playback.path}: no message type of it is installed: {', '.join(self.unknown_types)}")

    def unheard(self) -> list[str]:
        """Return the sensors' topics that no one subscribes to."""
        return [topic for topic, publisher in self._sensors.items() if not publisher.get_subscription_count()]

    def wait_for_subscribers(self, timeout_s: float) -> bool:
        """Wait until every sensor's topic has a subscriber; return whether that came true in time."""
        limit = time.monotonic() + timeout_s
        while self.unheard() and time.monotonic() < limit:
            time.sleep(0.02)
        time.sleep(_SETTLE_S)
        return not self.unheard()

    def play(self) -> Iterator[float]:
        """Publish every message once, yielding after each how many seconds of the recording have been played."""
        first, begin, clock_due = None, time.monotonic(), 0
        for topic, stamp, data in self.playback.messages():
            publisher = self._publishers_by_topic.get(topic)
            if publisher is None:
                continue
            first = stamp if first is None else first
            pause_s = begin + (stamp - first) / 1e9 / self._rate - time.monotonic()
            time.sleep(min(max(0.0, pause_s), _LONGEST_PAUSE_S))
            if self._clock_publisher and stamp >= clock_due:
                self._clock_publisher.publish(Clock(clock=Time(nanoseconds=stamp).to_msg()))
                clock_due = stamp + _CLOCK_PERIOD_NS
            publisher.publish(data)
            yield (stamp - first) / 1e9
        time.sleep(_SETTLE_S)

    def _advertise(self, topic: str, msgtype: str, is_latched: bool) -> None:
        if topic == "/clock" and self._clock_publisher:
            return
        message_type = message_class(msgtype)
        if message_type is None:
            self.unknown_types.append(msgtype)
            return
        durability = DurabilityPolicy.TRANSIENT_LOCAL if is_latched else DurabilityPolicy.VOLATILE
        quality = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE, durability=durability)
        publisher = self._publishers_by_topic[topic] = self.create_publisher(message_type, topic, quality)
        if msgtype == MAGNETIC_FIELD:
            self._sensors[topic] = publisher
