"""Play a recording onto topics in the rhythm in which it was recorded.

A bag is played as it was recorded, any other recording as the topics of this package.
"""

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.time import Time
from rosgraph_msgs.msg import Clock

from tam_calibration.messages.point_cloud import MAGNETIC_FIELD, topic_and_type
from tam_calibration.messages.samples import in_order
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.exceptions import InputError
from tam_calibration.nodes.topics import message_class
from tam_calibration.recordings.bag_reader import BagReader, raw_messages
from tam_calibration.recordings.bag_source import BagSource
from tam_calibration.recordings.bag_writing import serialise
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.recordings.choice import choose
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.recording_file import streams_of, tell_taken
from tam_calibration.recordings.tables import Source


class Playback(NamedTuple):
    """Serialised messages in the order in which they are published.

    Parameters
    ----------
    path : Path
        Of the recording.
    types : mapping of str to (str, bool)
        Type of the messages of each topic, and whether late joiners get the last one.
    messages : callable
        Yields topic, time in nanoseconds and bytes of each, from the beginning.
    duration_s : float, optional
        From the first to the last, seconds, where that is known beforehand.
    """

    path: Path
    types: Mapping[str, tuple[str, bool]]
    messages: Callable[[], Iterator[tuple[str, int, bytes]]]
    duration_s: float | None


def playback_of(source: Source, reading: Reading) -> Playback:
    """Return what a player publishes of a recording.

    A bag is played as it was recorded, unless a map is given, its names are others than those of this package and the
    choice of the sensors is certain, or it is of ROS 1.

    Parameters
    ----------
    source : Source
        An open recording.
    reading : Reading
        With the map, where there is one.

    Raises
    ------
    InputError
        When it is no bag, and what is meant is ambiguous.
    """
    if isinstance(source, BagSource) and not source.is_ros1 and not reading.channel_map and not _is_foreign(source):
        return _as_recorded(source.bag)
    streams = streams_of(source, reading)
    tell_taken(source, streams, {})
    topics = {stream: topic_and_type(stream) for stream in streams.wanted}
    types = {topic: (kind, False) for topic, kind in topics.values()}
    return Playback(source.path, types, lambda: _messages(source, streams, reading, topics), None)


def _is_foreign(source: Source) -> bool:
    """Return whether a recording has names of its own, and it is certain which are the sensors."""
    with suppress(InputError):
        choice = choose(source, None)
        return choice.channel_map is not None and not choice.doubts and not choice.is_own
    return False


def _as_recorded(bag: BagReader) -> Playback:
    types = {}
    for each in bag.connections:
        extra: Any = each.ext
        is_latched = any(one.durability.name == "TRANSIENT_LOCAL" for one in extra.offered_qos_profiles)
        types[each.topic] = each.msgtype, is_latched
    return Playback(
        bag.path,
        types,
        lambda: ((each.topic, time_ns, data) for each, time_ns, data in raw_messages(bag, bag.connections)),
        bag.duration / 1e9,
    )


def _messages(
    source: Source, streams: Streams, reading: Reading, topics: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, int, bytes]]:
    """Yield the messages of streams; one without a stamp has the time of the message before, the first are left out."""
    time_ns, intakes = None, streams.intakes(reading, None)
    for batch in source.batches(streams.wanted, streams.clock, lambda done, total: None):
        taken = {name: replace(each, values=intakes[name].take(each.values)[0]) for name, each in batch.items()}
        for stream, stamp_ns, row, _ in in_order(taken):
            time_ns = time_ns if stamp_ns is None else stamp_ns
            topic, kind = topics[stream]
            if time_ns is not None:
                yield topic, time_ns, serialise(kind, np.array([row]), np.array([time_ns])).tobytes()


_SETTLE_S = 0.3
"""Subscribers match a publisher a little later than it matches them, and take the last messages a little later.

The player sleeps for that, and between messages: it receives nothing that could wake it, and no one tells it of either.
"""


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
            # Clocks that are set make pauses of years, and a sleep has at most 292.
            time.sleep(min(max(0.0, pause_s), DAY_S))
            if self._clock_publisher and stamp >= clock_due:
                self._clock_publisher.publish(Clock(clock=Time(nanoseconds=stamp).to_msg()))
                clock_due = stamp + 10_000_000  # a hundred times a second
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
