"""Recordings as rosbag2: folders with sqlite3 or mcap inside, and single .mcap and .db3 files."""

import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader

from tam_calibration.correction.partial import missing_codes
from tam_calibration.files.bag_blocks import read_blocks, unnamed_topics
from tam_calibration.files.bag_damage import damage_named
from tam_calibration.files.bag_folder import PACKED
from tam_calibration.files.bag_recovery import readable
from tam_calibration.files.bag_storages import STORAGES
from tam_calibration.files.text_files import in_file, require_regular
from tam_calibration.messages.batch_stream import StreamMessages
from tam_calibration.messages.batch_synchroniser import BatchSynchroniser
from tam_calibration.messages.cdr import NO_TIME, RawMessages
from tam_calibration.messages.point_cloud import is_channel
from tam_calibration.messages.run import Run
from tam_calibration.messages.samples import Progress, Samples, seconds_of
from tam_calibration.messages.topics import StreamTopics, find_topics
from tam_calibration.messages.turning import turns_of
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused, quoted
from tam_calibration.model.limits import largest_of
from tam_calibration.model.units import FloatArray, IntArray

PATIENCE_NS = 5_000_000_000
"""How far in stamps the topics of a bag may lag behind each other."""

_CAPACITY = 1 << 24
"""More messages of a topic than wait within that patience."""

BATCH = 1 << 16
"""Messages that are joined at once: more leaves the caches, of fewer the patience would hold back a large part."""

log = logging.getLogger(__name__)


class BagReader(Reader):
    """The reader of rosbags, which opens files by the readers that are registered.

    Parameters
    ----------
    path : Path
        The bag, which sentences name.

    Attributes
    ----------
    unfinished : str
        What was recovered of a bag that its recorder did not finish, as a clause; empty where it did.
    """

    def __init__(self, path: Path) -> None:
        by_name = {storage.name: storage.load().READER for storage in STORAGES.values()}
        by_suffix = {storage.suffix: by_name[storage.name] for storage in STORAGES.values()}

        class Folder(DirectoryReader):
            STORAGE_PLUGINS = by_name

        self.STORAGE_PLUGINS = {"dir": Folder, **by_suffix}
        self._bag = readable(path)
        self.unfinished = self._bag.unfinished
        super().__init__(self._bag.path)
        self.path = path


@contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Open a bag for reading; of one that its recorder did not finish what is whole, with a warning.

    Raises
    ------
    InputError
        When the path is no bag, or the bag is empty or damaged.
    """
    require_regular(path)
    suffixes = tuple(storage.suffix for storage in STORAGES.values())
    if path.is_file() and not path.name.removesuffix(PACKED).endswith(suffixes):
        raise InputError(f"{path} is a bag by the name of something else: let its name end in {' or '.join(suffixes)}")
    reader = BagReader(path)
    if reader.unfinished:
        log.warning("%s: %s", path, reader.unfinished)
    with damage_named(path):
        reader.open()
        _require_names(reader.connections)
    if unnamed := unnamed_topics(reader):
        log.warning("%s: its metadata do not name %s, which is not read", path, ", ".join(unnamed))
    try:
        if not reader.message_count:
            raise InputError(f"{path} holds no message: the recorder wrote nothing, or was killed")
        yield reader
    finally:
        reader.close()


def _require_names(connections: Sequence[Connection]) -> None:
    """Check that topics have names, which in metadata of YAML may be anything."""
    for each in connections:
        if not (isinstance(each.topic, str) and isinstance(each.msgtype, str)):
            raise InputError(f"{quoted(each.topic)} of {quoted(each.msgtype)} is no topic with a type")


def raw_messages(reader: Reader, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, time of recording in nanoseconds, and serialised message, in the order of the bag.

    Parameters
    ----------
    reader : Reader
        An open bag.
    connections : sequence of Connection
        Those of its connections that are wanted.

    Raises
    ------
    InputError
        When the bag is damaged.
    """
    for block in raw_blocks(reader, connections):
        rows = zip(block.connection.tolist(), block.recorded_ns.tolist(), block.messages(), strict=True)
        yield from ((connections[number], recorded_ns, message) for number, recorded_ns, message in rows)


def raw_blocks(
    reader: Reader,
    connections: Sequence[Connection],
    progress: Progress = lambda done, total: None,
    with_times: bool = True,
) -> Iterator[RawMessages]:
    """Yield the messages of some connections, many at once, in the order of the bag.

    Parameters
    ----------
    reader : Reader
        An open bag.
    connections : sequence of Connection
        Those of its connections that are wanted; their places in it stand for them in the messages.
    progress : callable
        Called now and then with the bytes read, and how many there are.
    with_times : bool
        Whether the times of recording are wanted; without them some storages are read sooner.

    Raises
    ------
    InputError
        When the bag is damaged.
    """
    with damage_named(Path(str(reader.path))):
        yield from read_blocks(reader, connections, progress, with_times)


def read_bag(
    path: Path,
    sensor_count: int | None = None,
    tolerance_ns: int = 0,
    progress: Progress = lambda done, total: None,
    array: Array | None = None,
    with_partial: bool = False,
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
        Called now and then with the bytes read, and how many there are.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.
    with_partial : bool
        Whether samples are kept that lack a sensor that was silent.

    Raises
    ------
    InputError
        When the bag cannot be read, a topic is missing or of another type, or no sample can be joined.
    """
    with open_bag(path) as reader, in_file(path):
        topics = find_topics(reader.connections, sensor_count)
        stamps, rows, usage = [], [], None
        joined = _join(reader, topics, tolerance_ns, progress, array, with_partial)
        for stamps_ns, times_ns, values, usage in joined:  # noqa: B007
            stamps.append(stamps_ns)
            rows.append(np.column_stack([seconds_of(times_ns), values]))
        return _samples(topics, np.concatenate(stamps), np.concatenate(rows), usage, reader.unfinished)


def read_bag_pieces(
    path: Path,
    sensor_count: int | None = None,
    tolerance_ns: int = 0,
    progress: Progress = lambda done, total: None,
    array: Array | None = None,
    with_partial: bool = False,
) -> Iterator[Samples]:
    """Yield what `read_bag` returns in pieces of some ten thousand samples, so that a bag may be larger than memory.

    The pieces follow each other in time without a sample lost or doubled. A channel without a value in a whole piece
    is None in that piece alone.

    Parameters
    ----------
    path : Path
        The bag.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_ns : int
        Greatest difference of stamps within a sample, nanoseconds.
    progress : callable
        Called now and then with the bytes read, and how many there are.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.
    with_partial : bool
        Whether samples are kept that lack a sensor that was silent.

    Raises
    ------
    InputError
        As `read_bag` does, when the fault is met: pieces before it have been yielded by then.
    """
    with open_bag(path) as reader, in_file(path):
        topics = find_topics(reader.connections, sensor_count)
        joined = _join(reader, topics, tolerance_ns, progress, array, with_partial)
        for stamps_ns, times_ns, values, usage in joined:
            rows = np.column_stack([seconds_of(times_ns), values])
            yield _samples(topics, stamps_ns, rows, usage, reader.unfinished)


def _samples(
    topics: StreamTopics, stamps_ns: IntArray, rows: FloatArray, usage: Usage | None, unfinished: str
) -> Samples:
    """Return the samples of rows, with what they lack, and with how the bag was left."""
    usage = None if usage is None else replace(usage, unfinished=unfinished)
    last = 1 + 3 * topics.layout.sensor_count
    readings = rows[:, 1:last].reshape(-1, topics.layout.sensor_count, 3)
    codes = missing_codes(readings)
    if not codes.any():
        return Samples(topics.layout.recording(rows), stamps_ns, usage)
    filled = np.where(np.isnan(readings), np.nanmean(readings, axis=1, keepdims=True), readings)
    rows[:, 1:last] = filled.reshape(-1, last - 1)
    return Samples(topics.layout.recording(rows), stamps_ns, usage, codes)


_Joined = tuple[IntArray, IntArray, FloatArray, Usage]
"""Stamps, times in the run and values of samples, never none, and the usage until then."""


def _join(
    reader: Reader,
    topics: StreamTopics,
    tolerance_ns: int,
    progress: Progress,
    array: Array | None,
    with_partial: bool,
) -> Iterator[_Joined]:
    """Yield the samples, the last with the usage of the whole; steps and losses are logged at the end."""
    run = Run()
    held: _Joined | None = None
    synchroniser = BatchSynchroniser(
        topics.layout,
        tolerance_ns,
        patience_ns=PATIENCE_NS,
        hold_patience_ns=PATIENCE_NS,
        scalar_is_held=topics.scalar_is_held,
        expected=topics.layout.channels,
        capacity=_CAPACITY,
        delay_s=None if array is None else array.stamp_delay_s,
    )
    turns = {} if array is None else turns_of(array.mounting)
    for batch in _batches(reader, topics, progress):
        for name, messages in batch.items():
            usable = _usable(synchroniser, name, messages)
            batch[name] = usable.turned(turns[name]) if name in turns else usable
        stamps_ns, values = _kept(synchroniser, with_partial, *synchroniser.push_batch(batch))
        if held and len(stamps_ns):
            yield held
        if len(stamps_ns):
            held = stamps_ns, _times_in(run, synchroniser, stamps_ns, values), values, synchroniser.usage
    stamps_ns, values = _kept(synchroniser, with_partial, *synchroniser.flush_batch())
    if not (synchroniser.delivered or (with_partial and synchroniser.partial)):
        if synchroniser.lost:
            raise Refused(f"no sample could be joined: {'; '.join(synchroniser.lost)}; look at the driver")
        raise InputError(
            f"no sample could be joined by the stamps of the topics ({synchroniser.explain_losses()}): "
            "compare the stamps: do the drivers share one clock?"
        )
    if held:
        yield (*held[:3], synchroniser.usage)
    if len(stamps_ns):
        yield stamps_ns, _times_in(run, synchroniser, stamps_ns, values), values, synchroniser.usage
    for step in synchroniser.steps:
        log.warning("%s: a clock was set or a driver started anew, the run is kept", step)
    if any(losses.dropped or losses.missing or losses.unusable for losses in synchroniser.losses.values()):
        log.warning(synchroniser.explain_losses())


def _kept(
    synchroniser: BatchSynchroniser, with_partial: bool, stamps_ns: IntArray, values: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Return stamps and values of the samples that are wanted: the whole ones, or all."""
    if with_partial or not synchroniser.partial:
        return stamps_ns, values
    is_whole = np.isfinite(values[:, : 3 * synchroniser.sensor_count]).all(axis=1)
    return stamps_ns[is_whole], values[is_whole]


def _usable(synchroniser: BatchSynchroniser, stream: str, messages: StreamMessages) -> StreamMessages:
    """Return the messages of a stream that have a time and values, as the collector takes them; the others count."""
    is_beyond = np.abs(messages.values) > largest_of(stream)
    is_missing = is_beyond if is_channel(stream) else is_beyond | np.isnan(messages.values)
    usable = ~is_missing.any(axis=1)
    if messages.stamps_ns is not None:
        usable &= messages.stamps_ns != NO_TIME
    if usable.all():
        return messages
    synchroniser.refuse(stream, int((~usable).sum()))
    stamps_ns = None if messages.stamps_ns is None else messages.stamps_ns[usable]
    return StreamMessages(messages.order[usable], stamps_ns, messages.values[usable])


def _times_in(run: Run, synchroniser: BatchSynchroniser, stamps_ns: IntArray, values: FloatArray) -> IntArray:
    """Return the times of samples in their run: their stamps, without the steps back.

    Raises
    ------
    InputError
        When the first sample comes again.
    """
    times_ns, count, last = stamps_ns.copy(), len(stamps_ns), 3 * synchroniser.sensor_count
    # As long as stamps rise the run needs to know its first sample, and the newest two.
    for index in range(count) if synchroniser.restarts else sorted({0, max(count - 2, 0), count - 1}):
        stamp_ns = int(stamps_ns[index])
        if run.begins_again(stamp_ns, values[index, :last].tobytes()):
            raise InputError(
                "the stamps go backwards: keep one run (a bag that was played in a loop, or a sensor that restarted, "
                "makes several)"
            )
        times_ns[index] = run.time_ns(stamp_ns)
    return times_ns


def _batches(reader: Reader, topics: StreamTopics, progress: Progress) -> Iterator[dict[str, StreamMessages]]:
    """Yield the messages of all streams, decoded, many at once."""
    decoders = topics.decoders()
    parts: dict[str, list[StreamMessages]] = {name: [] for name in decoders}
    count = 0
    for block in raw_blocks(reader, list(topics.connections.values()), progress, with_times=False):
        for number, (name, connection) in enumerate(topics.connections.items()):
            order = np.flatnonzero(block.connection == number)
            if len(order):
                with in_topic(connection.topic):
                    stamps_ns, values = decoders[name](block.take(order))
                parts[name].append(StreamMessages(order + count, stamps_ns, values))
        count += len(block)
        if count >= BATCH:
            yield _concatenate(parts)
            parts, count = {name: [] for name in decoders}, 0
    yield _concatenate(parts)


def _concatenate(parts: dict[str, list[StreamMessages]]) -> dict[str, StreamMessages]:
    return {name: StreamMessages.concatenate(several) for name, several in parts.items() if several}


@contextmanager
def in_topic(topic: str) -> Iterator[None]:
    """Put the name of a topic before the message of an `InputError`."""
    try:
        yield
    except InputError as problem:
        raise InputError(f"topic {topic}: {problem}") from None
