"""What a player publishes: a bag as it was recorded, or the streams of any recording as the topics of this package."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from itertools import repeat
from operator import itemgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tam_calibration.messages.point_cloud import topic_and_type
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_reader import BagReader, raw_messages
from tam_calibration.recordings.bag_source import BagSource
from tam_calibration.recordings.bag_writing import serialise
from tam_calibration.recordings.choice import choose
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.reading import Reading
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
    return _of_streams(source, streams, reading)


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


def _of_streams(source: Source, streams: Streams, reading: Reading) -> Playback:
    topics = {stream: topic_and_type(stream) for stream in streams.wanted}
    return Playback(
        source.path,
        {topic: (kind, False) for topic, kind in topics.values()},
        lambda: _messages(source, streams, reading, topics),
        None,
    )


def _messages(
    source: Source, streams: Streams, reading: Reading, topics: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, int, bytes]]:
    """Yield the messages of streams; one without a stamp has the time of the message before, the first are left out."""
    time_ns, intakes = None, streams.intakes(reading, None)
    for batch in source.batches(streams.wanted, streams.clock, lambda done, total: None):
        rows = []
        for stream, each in batch.items():
            values, _ = intakes[stream].take(each.values)
            stamps = repeat(None) if each.stamps_ns is None else each.stamps_ns.tolist()
            rows += list(zip(each.order.tolist(), repeat(stream), stamps, values, strict=False))
        for _, stream, stamp_ns, row in sorted(rows, key=itemgetter(0)):
            time_ns = time_ns if stamp_ns is None else stamp_ns
            topic, kind = topics[stream]
            if time_ns is not None:
                yield topic, time_ns, serialise(kind, row[None], np.array([time_ns])).tobytes()
