"""Bags of every storage, folders and single files: their serialised messages, the complete ones of unfinished bags."""

import logging
import sys
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from glob import escape
from itertools import groupby
from pathlib import Path
from weakref import finalize

import numpy as np
from rosbags.interfaces import Connection
from zstandard import ZstdDecompressor, frame_content_size

from tam_calibration.files.text_files import require_regular, temporary_place, unfinished
from tam_calibration.messages.cdr import RawMessages
from tam_calibration.messages.samples import Progress
from tam_calibration.model.exceptions import MOST_NAMED, InputError, quoted
from tam_calibration.recordings import bag_storages
from tam_calibration.recordings.bag_bounds import Damaged, check_piece, damage_named, unpack_bounded, unpacked
from tam_calibration.recordings.bag_storages import Condition, StoredFile, serialisation_of, storage_for

log = logging.getLogger(__name__)

_ZSTD = b"\x28\xb5\x2f\xfd"
"""First bytes of a message that was compressed by itself; no serialised message of ROS 2 begins so."""


@dataclass(frozen=True)
class Recovered:
    """The complete messages of a bag.

    Parameters
    ----------
    messages : int
        How many messages.
    first_ns, last_ns : int
        When the first and the last of them were recorded, nanoseconds.
    faults : tuple of str
        Parts that were left out, as clauses.
    """

    messages: int
    first_ns: int
    last_ns: int
    faults: tuple[str, ...]

    def __str__(self) -> str:
        """Return a clause for people."""
        duration_s = (self.last_ns - self.first_ns) / 1e9
        ends = f"the recording ends at {self.last_ns / 1e9:.3f} s, {duration_s:.3f} s after it began"
        more = len(self.faults) - MOST_NAMED
        lost = [*self.faults[:MOST_NAMED], *([f"{more} faults more"] if more > 0 else [])]
        return f"{self.messages} complete messages are recovered, {ends}{''.join(f'; {each}' for each in lost)}"


class RecoveredFile(StoredFile):
    """The complete messages of a file without an end or an index; each pass finds them anew.

    Parameters
    ----------
    path : Path
        The file.
    faults : list of str
        Takes a clause for each part that is left out.
    """

    def __init__(self, path: Path, faults: list[str]) -> None:
        self._storage = storage_for(path)
        found: dict[int, Connection] = {}
        counts, empty = Counter[int](), Counter[str]()
        start_ns, end_ns = sys.maxsize, 0
        for one, recorded_ns, content in self._storage.complete_messages(path, faults):
            if not content:
                empty[one.topic] += 1
                continue
            found[one.id] = one
            counts[one.id] += 1
            start_ns, end_ns = min(start_ns, recorded_ns), max(end_ns, recorded_ns)
        faults += [f"empty messages of {topic}: {count} left out" for topic, count in empty.items()]
        super().__init__(path, [one._replace(msgcount=counts[one.id]) for one in found.values()], start_ns, end_ns)

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield messages in the order of writing, as of `StoredFile`, without the empty ones."""
        for one, recorded_ns, content in self._storage.complete_messages(self.path, []):
            if one.id in ids and content:
                yield one.id, recorded_ns, content


class BagReader:
    """A bag that can be read.

    Parameters
    ----------
    path : Path
        The bag, which sentences name.
    files : sequence of StoredFile
        Its files, in their order.

    Attributes
    ----------
    topics : list of Connection
        One for each topic, type and serialisation.
    connections : list of Connection
        One for each topic that can be read, of its most frequent type. Its ``ext.serialization_format`` is ``cdr`` or
        ``ros1``.
    message_count : int
        Messages of all topics.
    start_time, duration : int
        When the first message was recorded, and how long after it the last, nanoseconds.
    unfinished : str
        What was recovered of a bag that its recorder did not finish, as a clause; empty where it did.
    """

    def __init__(self, path: Path, files: Sequence[StoredFile]) -> None:
        self.path, self.files, self.unfinished = path, files, ""
        self.topics, self.connections = _merged(files), list[Connection]()
        self.message_count = sum(file.message_count for file in files)
        filled = [file for file in files if file.message_count]
        self.start_time = min((file.start_ns for file in filled), default=0)
        self.duration = max((file.end_ns for file in filled), default=0) - self.start_time


@contextmanager
def open_bag(path: Path) -> Iterator[BagReader]:
    """Open a bag for reading; of one that its recorder did not finish the complete messages, with a warning.

    It is unpacked and checked once for as long as its files stay as they are.

    Raises
    ------
    InputError
        When the path is no bag, or the bag is empty or damaged.
    """
    require_regular(path)
    parts = path.iterdir() if path.is_dir() else path.parent.glob(f"{escape(path.name)}*")
    states = [(part.name, part.stat()) for part in parts if part.is_file()]
    bag = _opened(path, tuple(sorted((name, state.st_size, state.st_mtime_ns) for name, state in states)))
    bag.connections = _chosen(path, bag.topics)
    if bag.unfinished:
        log.warning("%s: %s", path, bag.unfinished)
    yield bag


@lru_cache(maxsize=2)
def _opened(path: Path, state: tuple[tuple[str, int, int], ...]) -> BagReader:
    """Return a bag, recovered where it was not finished, once its topics and counts are those that it states.

    The folder with its unpacked files is removed with it.
    """
    faults: list[str] = []
    with ExitStack() as folder:
        with damage_named(path):
            files = bag_storages.data_files(path)
            if any(file.suffix == bag_storages.PACKED for file in files):
                files = unpacked(files, folder.enter_context(unfinished(temporary_place())))
            if missing := [file.name for file in files if not file.exists()]:
                raise Damaged(f"{missing[0]} is missing")
            conditions = {file: storage_for(file).condition_of(file) for file in files}
        metadata = bag_storages.read_metadata(path) if path.is_dir() else None
        is_unfinished = Condition.UNFINISHED in conditions.values() or (path.is_dir() and metadata is None)
        incomplete = [file for file, condition in conditions.items() if condition is not Condition.COMPLETE]
        with damage_named(path, may_recover=False):
            recovered = {file: RecoveredFile(file, faults) for file in incomplete}
        with damage_named(path):
            if faults and not is_unfinished:
                raise Damaged("; ".join(faults[:MOST_NAMED]))
            bag = BagReader(path, [recovered.get(file) or storage_for(file).FILE(file) for file in files])
            _require_topics(bag, None if is_unfinished else metadata)
        if not bag.message_count:
            no_message = "contains no message: the recorder wrote nothing, or was killed"
            lost = "is damaged or truncated: no message in it is complete"
            raise InputError(f"{path} {lost if incomplete else no_message}")
        if is_unfinished:
            found = Recovered(bag.message_count, bag.start_time, bag.start_time + bag.duration, tuple(faults))
            bag.unfinished = f"the recording was left unfinished: {found}"
        finalize(bag, folder.pop_all().close)
    return bag


def _require_topics(bag: BagReader, metadata: bag_storages.Metadata | None) -> None:
    """Check the names of topics and types, and that topics are there and serialised as the metadata have it."""
    for each in bag.topics:
        if not (isinstance(each.topic, str) and isinstance(each.msgtype, str)):
            raise Damaged(f"{quoted(each.topic)} of {quoted(each.msgtype)} is no topic with a type")
    if metadata is None:
        return
    found = {one.topic: serialisation_of(one) for one in bag.topics if one.msgcount}
    for topic, (count, stated) in metadata.topics.items():
        if count and topic not in found:
            raise Damaged(f"the metadata count {quoted(count)} messages of {topic}, which no file has")
        if stated != found.get(topic, stated):
            raise Damaged(f"{topic} is serialised as {quoted(found[topic])}, and as {quoted(stated)} by the metadata")


_Kind = tuple[str, str, str, str]


def _kind(one: Connection) -> _Kind:
    """Return by what the connections of several files, or publishers, are one topic: name, type and serialisation."""
    return one.topic, one.msgtype, serialisation_of(one), one.digest


def _merged(files: Sequence[StoredFile]) -> list[Connection]:
    """Return one connection for each topic, type and serialisation, with the number of messages in all files."""
    merged: dict[_Kind, Connection] = {}
    for one in (one for file in files for one in file.connections):
        known = merged.setdefault(_kind(one), one._replace(id=len(merged) + 1, msgcount=0))
        merged[_kind(one)] = known._replace(msgcount=known.msgcount + one.msgcount)
    return list(merged.values())


def _chosen(path: Path, topics: Sequence[Connection]) -> list[Connection]:
    """Return one connection for each topic that can be read, of its most frequent type; others are warned of."""
    chosen = []
    for topic, group in groupby(sorted(topics, key=lambda one: one.topic), lambda one: one.topic):
        several = sorted(group, key=lambda one: -one.msgcount)
        usable = [one for one in several if serialisation_of(one) in bag_storages.READABLE]
        for one in several:
            if one not in usable:
                log.warning("%s: %s is not read: its messages are %s", path, topic, serialisation_of(one))
        chosen += usable[:1]
        for one in usable[1:]:
            types = f"{one.msgcount} of {one.msgtype}; used: {chosen[-1].msgcount} of {chosen[-1].msgtype}"
            log.warning("%s: %s has messages of several types; left out: %s", path, topic, types)
    return sorted(chosen, key=lambda one: one.id)


def raw_messages(reader: BagReader, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, time of recording in nanoseconds, and serialised message, in the order of the bag.

    Parameters
    ----------
    reader : BagReader
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
    reader: BagReader, connections: Sequence[Connection], progress: Progress = lambda done, total: None
) -> Iterator[RawMessages]:
    """Yield the messages of some connections, many at once, in the order of the bag; empty ones are left out.

    Parameters
    ----------
    reader : BagReader
        An open bag.
    connections : sequence of Connection
        Those of its connections that are wanted; their places in it stand for them in the messages.
    progress : callable
        Called now and then with the bytes read, and how many there are.

    Raises
    ------
    InputError
        When the bag is damaged.
    """
    numbers = {_kind(one): number for number, one in enumerate(connections)}
    total = sum(file.path.stat().st_size for file in reader.files)
    done, empty = 0, np.zeros(len(connections), dtype=int)
    with damage_named(reader.path):
        for file in reader.files:
            position = {own.id: numbers[_kind(own)] for own in file.connections if _kind(own) in numbers}
            for block, size in file.blocks(position) if position else ():
                done = min(done + size, total)
                progress(done, total)
                is_empty = block.size == 0
                if is_empty.any():
                    empty += np.bincount(block.connection[is_empty], minlength=len(connections))
                    block = block.take(~is_empty)
                if len(block):
                    yield _unpacked(block)
    progress(total, total)
    for one, count in zip(connections, empty.tolist(), strict=True):
        if count:
            log.warning("%s: %d empty messages of %s are left out", reader.path, count, one.topic)


def _unpacked(messages: RawMessages) -> RawMessages:
    """Return messages of which each may be compressed; all by one decompressor: making it takes most of the time."""
    if bytes(messages.block[messages.start[0] :][: len(_ZSTD)]) != _ZSTD:
        return messages
    packed = messages.messages()
    sizes = [frame_content_size(each) for each in packed]  # -1 where a frame does not tell
    for each, size in zip(packed, sizes, strict=True):
        check_piece(len(each), size, "a message")
    check_piece(int(messages.size.sum()), sum(sizes), f"a block of {len(packed)} messages")
    decompressor = ZstdDecompressor()
    content = [
        unpack_bounded(each, "zstd", "a message") if size < 0 else decompressor.decompress(each)
        for each, size in zip(packed, sizes, strict=True)
    ]
    return RawMessages.of(messages.connection, messages.recorded_ns, content)
