"""The storage mcap: records read chunk by chunk, by the index that follows each; chunks are written with CRCs."""

import struct
from collections import Counter, defaultdict, deque
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple
from zlib import crc32

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.storage_mcap import McapWriter, PendingChunk, read_bytes, read_string
from rosbags.typesys.msg import normalize_msgtype

from tam_calibration.messages.cdr import ByteArray, RawMessages, join, windows
from tam_calibration.model.exceptions import MOST_NAMED, InputError
from tam_calibration.model.units import IntArray
from tam_calibration.recordings import bag_bounds
from tam_calibration.recordings.bag_storages import Condition, StoredFile, numbers_of

MAGIC = b"\x89MCAP0\r\n"

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, MESSAGE_INDEX, CHUNK_INDEX, STATISTICS, DATA_END = 2, 3, 4, 5, 6, 7, 8, 11, 15
"""Kinds of records."""

_HEAD = struct.Struct("<BQ")


_END = struct.Struct("<BQQQI8s")
"""The end of a file: footer with places of summary and summary offsets, CRC of both, and magic."""

_DATA_END_RECORD = struct.Struct("<BQI")
_CHUNK_HEAD = struct.Struct("<QQQI")

MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence number, time of recording and time of publishing before a message."""


_MSG, _IDL = MessageDefinitionFormat.MSG, MessageDefinitionFormat.IDL
_FORMATS = {"ros2msg": _MSG, "ros1msg": _MSG, "ros2idl": _IDL, "omgidl": _IDL}
"""Encodings of schemas that rosbags can parse; other definitions are left out."""

_IDL_HEAD = "=" * 80 + "\nIDL: "
"""What ROS 2 writes before each definition in IDL, and rosbags knows them by."""


def records(stream: BinaryIO, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind of each record, and place and size of its content, which may reach beyond the end."""
    while begin + _HEAD.size <= end:
        stream.seek(begin)
        kind, size = _HEAD.unpack(stream.read(_HEAD.size))
        if not kind:  # allocated room that was never written to
            return
        yield kind, begin + _HEAD.size, size
        begin += _HEAD.size + size


def read_content(stream: BinaryIO, place: int, size: int) -> bytes:
    """Return the content of a record.

    Raises
    ------
    InputError
        When it is larger than it may be.
    """
    bag_bounds.check_piece(size, size, "a record")
    stream.seek(place)
    return stream.read(size)


class Topics:
    """The topics of a file, learned from its records.

    Attributes
    ----------
    connections : dict of int to Connection
        By the numbers of their channels.
    """

    def __init__(self) -> None:
        self.connections: dict[int, Connection] = {}
        self._types: dict[int, tuple[str, MessageDefinition]] = {}

    def learn(self, stream: BinaryIO, kind: int, place: int, size: int) -> None:
        """Take in the type or topic of a record, if it contains one.

        Raises
        ------
        InputError
            When a topic is described at too great length.
        """
        if kind not in (SCHEMA, CHANNEL):
            return
        content = BytesIO(read_content(stream, place, size))
        number = int.from_bytes(content.read(2), "little")
        if kind == SCHEMA:
            name, encoding = read_string(content), read_string(content)
            self._types[number] = _type_of(name, encoding, bytes(read_bytes(content)))
            return
        unknown = "__schemaless__", MessageDefinition(MessageDefinitionFormat.NONE, "")
        name, definition = self._types.get(int.from_bytes(content.read(2), "little"), unknown)
        topic, encoding, further = read_string(content), read_string(content), _read_map(read_bytes(content))
        extra = ConnectionExtRosbag2(encoding, bag_bounds.quality_of(further.get("offered_qos_profiles", "")))
        digest = further.get("topic_type_hash", "")
        self.connections[number] = Connection(number, topic, name, definition, digest, 0, extra, self)
        bag_bounds.check_topics(len(self.connections))


def _type_of(name: str, encoding: str, text: bytes) -> tuple[str, MessageDefinition]:
    """Return name and definition of a type as ROS 2 has them."""
    known = _FORMATS.get(encoding, MessageDefinitionFormat.NONE)
    definition = "" if known is MessageDefinitionFormat.NONE else text.decode()
    name = normalize_msgtype(name) if encoding == "ros1msg" else name.replace("::", "/")
    if known is MessageDefinitionFormat.IDL and not definition.startswith(_IDL_HEAD):
        definition = f"{_IDL_HEAD}{name}\n{definition}"
    return name, MessageDefinition(known, definition)


def _read_map(content: bytes) -> dict[str, str]:
    stream, texts = BytesIO(content), []
    while stream.tell() < len(content):
        texts.append((read_string(stream), read_string(stream)))
    return dict(texts)


class End(NamedTuple):
    """What the end of a finished file says: where the footer and the summary begin, and the CRC of the summary."""

    place: int
    summary: int
    summary_crc: int


def read_end(file: BinaryIO) -> End | None:
    """Return the end of a file; None where it has none."""
    if file.seek(0, 2) < _END.size:
        return None
    place = file.seek(-_END.size, 2)
    kind, length, summary, _, crc, magic = _END.unpack(file.read())
    return End(place, summary, crc) if (kind, length, magic) == (FOOTER, 20, MAGIC) else None


def crc_of_data(file: BinaryIO, end: End) -> tuple[int, int]:
    """Return the CRC-32 of the data section of a file, and the one that is written there, 0 for none."""
    begin = (end.summary or end.place) - _DATA_END_RECORD.size
    file.seek(max(begin, 0))
    kind, _, written = _DATA_END_RECORD.unpack(file.read(_DATA_END_RECORD.size))
    return (_crc_of(file, 0, begin), written) if kind == DATA_END and written else (0, 0)


def crc_of_summary(file: BinaryIO, end: End) -> int:
    """Return the CRC-32 of the summary of a file, and of the footer as far as that goes before it."""
    return _crc_of(file, end.summary or end.place, end.place + _END.size - len(MAGIC) - 4)


def seal(path: Path) -> None:
    """Put the CRCs of data section and summary into a file that was written without."""
    with path.open("r+b") as file:
        end = read_end(file)
        assert end is not None
        begin = end.summary - _DATA_END_RECORD.size
        data_crc = _crc_of(file, 0, begin)
        file.seek(begin)
        file.write(_DATA_END_RECORD.pack(DATA_END, 4, data_crc))
        crc = crc_of_summary(file, end)
        file.seek(-len(MAGIC) - 4, 2)
        file.write(crc.to_bytes(4, "little"))


def _crc_of(file: BinaryIO, begin: int, end: int) -> int:
    file.seek(begin)
    crc = 0
    while begin < end and (block := file.read(min(1 << 20, end - begin))):
        crc, begin = crc32(block, crc), begin + len(block)
    return crc


def complete_messages(path: Path, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield what is complete in a file, finished or not, as of `RegisteredStorage`."""
    topics, end = Topics(), path.stat().st_size
    with path.open("rb") as file:
        beginning = file.read(len(MAGIC))
        if beginning != MAGIC[: len(beginning)]:
            raise InputError(f"{path.name} does not begin as an mcap file does")
        for kind, place, size in records(file, len(MAGIC), end):  # the summary knows the topics of a damaged chunk
            if place + size <= end:
                topics.learn(file, kind, place, size)
        yield from _walk(file, len(MAGIC), end, topics, faults)


def _walk(
    stream: BinaryIO, begin: int, end: int, topics: Topics, faults: list[str], in_chunk: bool = False
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield messages; a last one before unwritten room is left out, as its own end may be unwritten too."""
    held: list[tuple[Connection, int, bytes]] = []
    reached = begin
    for kind, place, size in records(stream, begin, end):
        yield from held
        held, reached = [], place + size
        if kind == CHUNK and not in_chunk:
            content = _complete_part(read_content(stream, place, min(size, end - place)), size, place, faults)
            yield from _walk(BytesIO(content), 0, len(content), topics, faults, in_chunk=True)
        if kind == DATA_END or reached > end:
            return
        topics.learn(stream, kind, place, size)
        if kind == MESSAGE and size >= MESSAGE_HEAD.size:
            content = read_content(stream, place, size)
            channel, _, recorded_ns, _ = MESSAGE_HEAD.unpack_from(content)
            if channel in topics.connections:
                held = [(topics.connections[channel], recorded_ns, content[MESSAGE_HEAD.size :])]
    if reached + _HEAD.size > end:
        yield from held


def _complete_part(record: bytes, size: int, place: int, faults: list[str]) -> bytes:
    """Return what is complete in the record of a chunk of that size: all, nothing, or the beginning before a cut."""
    stream = BytesIO(record)
    try:
        first_ns, last_ns, unpacked, crc = _CHUNK_HEAD.unpack(stream.read(_CHUNK_HEAD.size))
        compression, packed_size = read_string(stream), int.from_bytes(stream.read(8), "little")
    except Exception:  # of struct, of rosbags, or no UTF-8
        return b""
    packed = stream.read(min(packed_size, len(record)))
    bag_bounds.check_piece(packed_size, unpacked, "a chunk")
    try:
        if len(packed) < packed_size:
            return bag_bounds.unpack_beginning(packed, compression, unpacked)
        content = bag_bounds.unpack(packed, compression, unpacked)
        if crc in (0, crc32(content)):
            return content
    except Exception:  # whatever the decompressors raise
        if len(record) < size:
            return b""
    faults.append(f"the chunk at byte {place}, recorded at {first_ns / 1e9:.3f} s to {last_ns / 1e9:.3f} s, is damaged")
    return b""


_RECORD = np.dtype(
    [("kind", "u1"), ("size", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
"""Fields before the serialised message in the record of a message."""


_INDEX_HEAD = struct.Struct("<BQHI")
"""Head of the record, channel and size of the list before the entries of an index."""


class _Chunk(NamedTuple):
    """A chunk by its entry in the summary; ``indices`` are place and length of the index of each channel."""

    start_ns: int
    end_ns: int
    place: int
    length: int
    indices: dict[int, tuple[int, int]]
    compression: str
    packed_size: int
    size: int


class McapFile(StoredFile):
    """A finished file with an index of its chunks.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._chunks, topics, stated = list[_Chunk](), Topics(), None
        with path.open("rb") as file:
            end = read_end(file)
            for kind, place, size in records(file, end.summary, end.place) if end and end.summary else ():
                topics.learn(file, kind, place, size)
                if kind == CHUNK_INDEX:
                    self._chunks.append(_parse_chunk(read_content(file, place, size)))
                elif kind == STATISTICS:
                    stated = int.from_bytes(read_content(file, place, size)[:8], "little")
        counts: Counter[int] = Counter()
        for chunk in self._chunks:
            counts.update({channel: length // 16 for channel, (_, length) in chunk.indices.items()})
        known = topics.connections
        connections = [one._replace(msgcount=counts[one.id]) for one in known.values()]
        filled = [chunk for chunk in self._chunks if chunk.indices]
        start_ns = min((chunk.start_ns for chunk in filled), default=0)
        super().__init__(path, connections, start_ns, max((chunk.end_ns for chunk in filled), default=0))
        self.is_indexed = counts.total() == stated and counts.keys() <= known.keys()

    def blocks(self, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
        """Yield the messages of each chunk that come before those of the next, as of `StoredFile`."""
        chunks = [chunk for chunk in self._chunks if chunk.indices.keys() & position]
        chunks.sort(key=lambda chunk: (chunk.start_ns, chunk.place))
        waiting: list[tuple[_Chunk, RawMessages]] = []
        with self.path.open("rb") as file:
            for chunk, following in zip(chunks, [*chunks[1:], None], strict=True):
                ready, later = [], []
                for each, messages in [*waiting, (chunk, self._read_chunk(file, chunk, position))]:
                    count = len(messages) if following is None else _count_before(each, messages, following)
                    ready.append((each.place, messages.take(slice(count))))
                    if count < len(messages):
                        later.append((each, messages.take(slice(count, None))))
                waiting = later
                ready.sort(key=lambda part: part[0])  # at equal times those of the first chunk in the file come first
                yield join([messages for _, messages in ready]).in_order(), chunk.length

    def _read_chunk(self, file: BinaryIO, chunk: _Chunk, position: Mapping[int, int]) -> RawMessages:
        """Return the messages of a chunk in the order of recording."""
        bag_bounds.check_piece(chunk.length, chunk.length, "a chunk with its index")
        file.seek(chunk.place)
        stored = file.read(chunk.length)
        *_, check = _CHUNK_HEAD.unpack_from(stored, _HEAD.size)
        begin = _HEAD.size + _CHUNK_HEAD.size + 4 + len(chunk.compression) + 8  # a length before both strings
        content = bag_bounds.unpack(stored[begin : begin + chunk.packed_size], chunk.compression, chunk.size)
        if check and crc32(content) != check:
            raise bag_bounds.Damaged(_named_damage(self.path))
        block = np.frombuffer(content, np.uint8)
        channel, record = _read_index(stored, chunk, position)
        if len(record) and int(record.max()) + _RECORD.itemsize > len(block):
            raise bag_bounds.Damaged("the index of a chunk does not fit the chunk")
        heads = windows(block, _RECORD.itemsize)[record].view(_RECORD)
        start, size = record + _RECORD.itemsize, heads["size"].astype(np.int64) - 22  # its fields before the message
        is_message = (heads["kind"] == MESSAGE) & (heads["channel"] == channel)
        is_message &= np.diff(record, prepend=-1) > 0
        if not is_message.all() or (size < 0).any() or (start + size > len(block)).any():
            raise bag_bounds.Damaged("the index of a chunk does not fit the chunk")
        return RawMessages(
            numbers_of(position)[channel], heads["log_ns"].astype(np.int64), start, size, block
        ).in_order()


def _parse_chunk(content: bytes) -> _Chunk:
    """Return the entry of a chunk in the summary."""
    stream = BytesIO(content)
    start_ns, end_ns, place, size = struct.unpack("<QQQQ", stream.read(32))
    places = sorted((begin, channel) for channel, begin in struct.iter_unpack("<HQ", read_bytes(stream)))
    length = size + int.from_bytes(stream.read(8), "little")
    compression, sizes = read_string(stream), struct.unpack("<QQ", stream.read(16))
    ends = [*(begin for begin, _ in places[1:]), place + length]
    indices = {
        channel: (begin - place + _INDEX_HEAD.size, end - begin - _INDEX_HEAD.size)
        for (begin, channel), end in zip(places, ends, strict=True)
        if end - begin > _INDEX_HEAD.size
    }
    return _Chunk(start_ns, end_ns, place, length, indices, compression, *sizes)


def _read_index(stored: bytes, chunk: _Chunk, position: Mapping[int, int]) -> tuple[IntArray, IntArray]:
    """Return the channel of each record of some channels in a chunk, and where it begins, rising."""
    channels, places = [], []
    for channel in chunk.indices.keys() & position:
        begin, length = chunk.indices[channel]
        places.append(np.frombuffer(stored, "<i8", length // 8, begin)[1::2])
        channels.append(np.full(len(places[-1]), channel))
    record = np.concatenate(places)
    order = np.argsort(record, kind="stable")
    return np.concatenate(channels)[order], record[order]


def _count_before(chunk: _Chunk, messages: RawMessages, following: _Chunk) -> int:
    """Return how many of a chunk's messages come before those of a later chunk."""
    side: Literal["left", "right"] = "right" if chunk.place < following.place else "left"
    return int(np.searchsorted(messages.recorded_ns, following.start_ns, side))


def condition_of(path: Path) -> Condition:
    """Return how a file was left, as of `RegisteredStorage`; what has a CRC is compared with it."""
    with path.open("rb") as file:
        beginning = file.read(len(MAGIC))
        end = read_end(file)
        if end is None and beginning == MAGIC[: len(beginning)]:
            return Condition.UNFINISHED
        if end is None or beginning != MAGIC:
            raise bag_bounds.Damaged("it does not begin as an mcap file does")
        if end.summary and not len(MAGIC) <= end.summary <= end.place:
            raise bag_bounds.Damaged("its summary lies outside")
        if end.summary_crc not in (0, crc_of_summary(file, end)):
            raise bag_bounds.Damaged("its summary does not fit its CRC")
        found, written = crc_of_data(file, end)
        if found != written:
            raise bag_bounds.Damaged(_named_damage(path))
    return Condition.COMPLETE if McapFile(path).is_indexed else Condition.NOT_INDEXED


def _named_damage(path: Path) -> str:
    """Return what is damaged in a file whose data do not fit their CRC."""
    faults: list[str] = []
    deque(complete_messages(path, faults), maxlen=0)
    return "; ".join(faults[:MOST_NAMED]) or "it does not fit its CRC, though all messages do"


class McapBlockWriter(McapWriter):
    """The mcap writer of rosbags, with CRCs and for many messages at once: one by one takes four times as long."""

    chunk_bytes = 1 << 20
    """Of a chunk, as rosbags has them."""

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id, in their order.

        Parameters
        ----------
        messages : RawMessages
            Their connections are ids of this writer's.
        """
        while len(messages):
            ends = self.chunk.bio.tell() + np.cumsum(messages.size + _RECORD.itemsize)
            count = int(np.searchsorted(ends, self.chunk_bytes, "right")) + 1
            self._add(messages.take(slice(count)))
            messages = messages.take(slice(count, None))
            if self.chunk.bio.tell() > self.chunk_bytes:
                self.close_chunk()

    def _add(self, messages: RawMessages) -> None:
        """Add messages to the chunk."""
        chunk, times = self.chunk, messages.recorded_ns
        content, begins = _records_of(messages)
        offsets = chunk.bio.tell() + begins
        chunk.bio.write(content.data)
        for one in (self, chunk):
            one.message_start_time = min(one.message_start_time, int(times.min()))
            one.message_end_time = max(one.message_end_time, int(times.max()))
        for channel in dict.fromkeys(messages.connection.tolist()):
            own = messages.connection == channel
            entries: Any = np.column_stack([times[own], offsets[own]])  # as rosbags has them of single messages
            chunk.msgs[channel].append(entries)
            self.channel_stats[channel] += len(entries)

    def close_chunk(self) -> None:
        """Write the chunk that is complete, with its CRC, and where it has the messages of each channel."""
        content, times = self.chunk.bio.getvalue(), (self.chunk.message_start_time, self.chunk.message_end_time)
        packed, name = self.compressor(content), self.compression.encode()
        packing = struct.pack(f"<I{len(name)}sQ", len(name), name, len(packed))
        head, begin = _CHUNK_HEAD.pack(*times, len(content), crc32(content)) + packing, self.bio.tell()
        self.bio.write(_HEAD.pack(CHUNK, len(head) + len(packed)) + head + packed)
        end, places = self.bio.tell(), b""
        for channel, entries in self.chunk.msgs.items():
            places += struct.pack("<HQ", channel, self.bio.tell())
            listed = np.vstack(entries).astype("<u8").tobytes()
            length = _INDEX_HEAD.size - _HEAD.size + len(listed)
            self.bio.write(_INDEX_HEAD.pack(MESSAGE_INDEX, length, channel, len(listed)) + listed)
        index = BytesIO()
        index.write(struct.pack("<QQQQI", *times, begin, end - begin, len(places)) + places)
        index.write(struct.pack("<Q", self.bio.tell() - end) + packing + struct.pack("<Q", len(content)))
        self.chunks.append(index)
        self.chunk = PendingChunk(2**63 - 1, 0, BytesIO(), defaultdict(list))

    def close(self, version: int, metadata: str) -> None:
        """Write the summary, and close the file.

        Parameters
        ----------
        version : int
            Of the bag's metadata.
        metadata : str
            What ``metadata.yaml`` of the bag says, kept in the file too.
        """
        super().close(version, metadata)
        seal(self.path)


def _records_of(messages: RawMessages) -> tuple[ByteArray, IntArray]:
    """Return the records of messages, one after another, and where each begins."""
    heads = np.zeros(len(messages), _RECORD)
    heads["kind"], heads["size"] = MESSAGE, messages.size + MESSAGE_HEAD.size
    heads["channel"], heads["log_ns"] = messages.connection, messages.recorded_ns
    heads["publish_ns"] = messages.recorded_ns
    sizes = messages.size + _RECORD.itemsize
    begins = np.cumsum(sizes) - sizes
    content = np.empty(int(sizes.sum()), np.uint8)
    windows(content, _RECORD.itemsize)[begins] = heads.view(f"V{_RECORD.itemsize}")
    for size in np.unique(messages.size[messages.size > 0]).tolist():
        own = np.flatnonzero(messages.size == size)
        windows(content, size)[begins[own] + _RECORD.itemsize] = windows(messages.block, size)[messages.start[own]]
    return content, begins


FILE, WRITER = McapFile, McapBlockWriter
