"""Recordings as rosbag2: folders with sqlite3 or mcap inside, and single .mcap and .db3 files."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader

from tam_calibration.files.bag_topics import StreamTopics, find_topics
from tam_calibration.files.location import in_file
from tam_calibration.files.samples import Progress, Samples
from tam_calibration.problems import InputError
from tam_calibration.synchronisation import Sample, Synchroniser

PATIENCE_NS = 5_000_000_000
"""How far in stamps the topics of a bag may lag behind each other."""

PROGRESS_EVERY = 10_000

log = logging.getLogger(__name__)


@contextmanager
def open_bag(path: Path) -> Iterator[Reader]:
    """Open a bag for reading.

    Raises
    ------
    InputError
        When the path is no bag, or the bag is empty or damaged.
    """
    if path.is_dir() and not (path / "metadata.yaml").exists():
        raise InputError(f"{path} holds no metadata.yaml: is it a bag? `ros2 bag reindex` writes the file anew")
    reader = Reader(path)
    with _damage_named(path):
        reader.open()
    try:
        if not reader.message_count:
            raise InputError(f"{path} holds no message: the recorder wrote nothing, or was killed")
        yield reader
    finally:
        reader.close()


def storage_of(path: Path) -> str:
    """Return in what a bag is stored: ``sqlite3`` or ``mcap``."""
    return "mcap" if path.suffix == ".mcap" or any(path.glob("*.mcap*")) else "sqlite3"


def raw_messages(reader: Reader, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, time of recording in nanoseconds, and serialised message, in the order of the bag.

    Raises
    ------
    InputError
        When the bag is damaged.
    """
    with _damage_named(Path(str(reader.path))):
        yield from reader.messages(connections)


@contextmanager
def _damage_named(path: Path) -> Iterator[None]:
    try:
        yield
    except Exception as problem:  # rosbags lets through whatever its decompressors and databases raise
        reason = str(problem).partition("\n")[0] or type(problem).__name__
        raise InputError(f"{path} is damaged or truncated: {reason}") from problem


def read_bag(
    path: Path,
    sensor_count: int | None = None,
    tolerance_ns: int = 1_000_000,
    progress: Progress = lambda done, total: None,
) -> Samples:
    """Read the topics of an array from a bag and join them by their stamps; losses are logged.

    Parameters
    ----------
    path : Path
        The bag.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_ns : int
        Greatest difference of stamps within a sample.
    progress : callable
        Called now and then with the messages read, and how many there are.

    Raises
    ------
    InputError
        When the bag cannot be read, a topic is missing or of another type, or no sample can be joined.
    """
    with open_bag(path) as reader, in_file(path):
        topics = find_topics(reader.connections, sensor_count)
        synchroniser = Synchroniser(
            topics.layout,
            tolerance_ns,
            patience_ns=PATIENCE_NS,
            hold_patience_ns=PATIENCE_NS,
            scalar_is_held=topics.scalar_is_held,
            expected=topics.layout.channels,
        )
        samples = _synchronise(reader, topics, synchroniser, progress)
        _check(samples, synchroniser)
        rows = np.array([(sample.stamp_ns / 1_000_000_000, *sample.values) for sample in samples])
        return Samples(topics.layout.recording(rows), np.array([sample.stamp_ns for sample in samples]))


def _synchronise(reader: Reader, topics: StreamTopics, synchroniser: Synchroniser, progress: Progress) -> list[Sample]:
    streams = {connection.topic: stream for stream, connection in topics.connections.items()}
    readers = topics.readers()
    connections = list(topics.connections.values())
    total = sum(connection.msgcount for connection in connections)
    samples = []
    for index, (connection, _, message) in enumerate(raw_messages(reader, connections)):
        stream = streams[connection.topic]
        try:
            stamp_ns, values = readers[stream](message)
        except InputError as problem:
            raise InputError(f"topic {connection.topic}: {problem}") from None
        samples += synchroniser.push(stream, stamp_ns, values)
        if index % PROGRESS_EVERY == 0:
            progress(index, total)
    progress(total, total)
    return samples + synchroniser.flush()


def _check(samples: list[Sample], synchroniser: Synchroniser) -> None:
    if not samples:
        raise InputError(
            f"no sample could be joined by the stamps of the topics ({synchroniser.explain_losses()}): "
            "compare the stamps; where they only differ a little, raise the tolerance"
        )
    if synchroniser.restarts:
        raise InputError(
            f"the stamps go backwards {synchroniser.restarts} times: keep one run (a bag that was played in a loop, "
            "or a sensor that restarted, makes several)"
        )
    if any(losses.dropped or losses.missing for losses in synchroniser.losses.values()):
        log.warning(synchroniser.explain_losses())
