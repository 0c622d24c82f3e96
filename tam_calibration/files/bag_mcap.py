"""The storage mcap: messages read chunk by chunk, by the index that follows each, and written as chunks with CRCs."""

import struct
from collections import Counter
from collections.abc import Collection, Generator, Iterator, Mapping
from io import SEEK_END, BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Literal
from zlib import crc32

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2.storage_mcap import MAXSIZE, ChunkInfo, McapReader, McapWriter, Statistics

from tam_calibration.files.bag_bounds import check_piece, unpack
from tam_calibration.files.mcap_guard import RECORD_HEAD, McapGuard, check_topics, records, seal
from tam_calibration.messages.cdr import ByteArray, RawMessages, join, windows
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import IntArray

_RECORD = np.dtype(
    [("kind", "u1"), ("size", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
"""What stands before the serialised message in the record of a message."""

_MESSAGE, _CHUNK, _INDEX = 5, 6, 7
"""Kinds of records."""

_SIZE_BEYOND_MESSAGE = 22
"""Bytes of a record that its size counts beside the message."""

_CHUNK_FIELDS = 40
_CHECKSUM, _CHUNK_HEAD, _INDEX_HEAD = 9 + 24, 9 + _CHUNK_FIELDS, 15

CHUNK_BYTES = 1 << 20
"""Of messages, at least, in a chunk that is written."""


class BoundedMcapReader(McapReader):
    """The mcap reader of rosbags; a file without index is read as it stands, its chunks within bounds."""

    def read_index(self) -> None:
        """Read the summary."""
        assert self.bio is not None
        check_topics(self.bio, self.data_end, self.bio.seek(0, SEEK_END))
        super().read_index()

    def meta_scan(self) -> None:
        """Count the messages of each topic."""
        connections: dict[int, Connection] = {}
        counts: Counter[int] = Counter()
        first_ns, last_ns = MAXSIZE, 0
        for connection, recorded_ns, _ in self._stored():
            connections[connection.id] = connection
            counts[connection.id] += 1
            first_ns, last_ns = min(first_ns, recorded_ns), max(last_ns, recorded_ns)
        self.connections = list(connections.values())
        self.statistics = Statistics(counts.total(), 0, len(counts), 0, 0, 0, first_ns, last_ns, dict(counts))

    def messages_scan(
        self, connections: Collection[Connection], start: int | None = None, stop: int | None = None
    ) -> Generator[tuple[Connection, int, bytes], None, None]:
        """Yield messages as they stand in the file.

        Parameters
        ----------
        connections : collection of Connection
            Those that are wanted.
        start, stop : int, optional
            Not used: all of the time is read.
        """
        wanted = {each.id: each for each in connections}
        for connection, recorded_ns, message in self._stored():
            if connection.id in wanted:
                yield wanted[connection.id], recorded_ns, message

    def _stored(self) -> Iterator[tuple[Connection, int, bytes]]:
        faults: list[str] = []
        yield from McapGuard(Path(str(self.path))).whole_messages(faults)
        if faults:
            raise InputError("; ".join(faults))


def read_blocks(
    file: McapReader, position: Mapping[int, int], with_times: bool
) -> Iterator[tuple[RawMessages, int]] | None:
    """Return blocks of messages as ``Storage`` asks; None where no index tells of chunks.

    Parameters
    ----------
    file : McapReader
        An open file.
    position : mapping of int to int
        For the id of each wanted connection the number that stands for it in the messages.
    with_times : bool
        Makes no difference: the times of recording are always read.
    """
    return _chunks(file, position) if file.chunks else None


def _chunks(storage: McapReader, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of each chunk that come before those of the next."""
    chunks = [chunk for chunk in storage.chunks if not chunk.channel_count or chunk.channel_count.keys() & position]
    chunks.sort(key=lambda chunk: (chunk.message_start_time, chunk.chunk_start_offset))
    waiting: list[tuple[ChunkInfo, RawMessages]] = []
    for chunk, following in zip(chunks, [*chunks[1:], None], strict=True):
        ready, later = [], []
        for each, messages in [*waiting, (chunk, _read_chunk(storage, chunk, position))]:
            count = len(messages) if following is None else _count_before(each, messages, following)
            ready.append((each.chunk_start_offset, messages.take(slice(count))))
            if count < len(messages):
                later.append((each, messages.take(slice(count, None))))
        waiting = later
        yield _merge(ready), chunk.chunk_length + chunk.message_index_length


def _count_before(chunk: ChunkInfo, messages: RawMessages, following: ChunkInfo) -> int:
    """Return how many of a chunk's messages come before those of a later chunk."""
    side: Literal["left", "right"] = "right" if chunk.chunk_start_offset < following.chunk_start_offset else "left"
    return int(np.searchsorted(messages.recorded_ns, following.message_start_time, side))


def _merge(parts: list[tuple[int, RawMessages]]) -> RawMessages:
    if len(parts) == 1:
        return parts[0][1]
    merged = join([messages for _, messages in sorted(parts, key=lambda part: part[0])])
    return merged.take(np.argsort(merged.recorded_ns, kind="stable"))


def _read_chunk(storage: McapReader, chunk: ChunkInfo, position: Mapping[int, int]) -> RawMessages:
    """Return the messages of a chunk in the order of recording."""
    assert storage.bio is not None
    length = chunk.chunk_length + chunk.message_index_length
    check_piece(length, length, "a chunk with its index")
    storage.bio.seek(chunk.chunk_start_offset)
    stored = storage.bio.read(length)
    begin = _CHUNK_HEAD + len(chunk.compression)
    check = int.from_bytes(stored[_CHECKSUM : _CHECKSUM + 4], "little")
    content = unpack(stored[begin : begin + chunk.compressed_size], chunk.compression, chunk.uncompressed_size)
    if check and crc32(content) != check:
        raise InputError(McapGuard(Path(str(storage.path))).damaged_messages())
    block = np.frombuffer(content, np.uint8)
    channel, record = _read_index(stored, chunk, position) if chunk.channel_count else _walk(content, position)
    if len(record) and int(record.max()) + _RECORD.itemsize > len(block):
        raise InputError("the index of a chunk does not fit the chunk")
    heads = windows(block, _RECORD.itemsize)[record].view(_RECORD)
    start, size = record + _RECORD.itemsize, heads["size"].astype(np.int64) - _SIZE_BEYOND_MESSAGE
    is_message = (heads["kind"] == _MESSAGE) & (heads["channel"] == channel) & (np.diff(record, prepend=-1) > 0)
    if not is_message.all() or (size < 0).any() or (start + size > len(block)).any():
        raise InputError("the index of a chunk does not fit the chunk")
    number = np.zeros(max(position) + 1, dtype=np.int64)
    number[list(position)] = list(position.values())
    messages = RawMessages(number[channel], heads["log_ns"].astype(np.int64), start, size, block)
    is_in_order = bool((np.diff(messages.recorded_ns) >= 0).all())
    return messages if is_in_order else messages.take(np.argsort(messages.recorded_ns, kind="stable"))


def _read_index(stored: bytes, chunk: ChunkInfo, position: Mapping[int, int]) -> tuple[IntArray, IntArray]:
    """Return the channel of each record of some channels in a chunk, and where it begins, rising."""
    channels, places = [], []
    for channel in chunk.channel_count.keys() & position:
        count = chunk.channel_count[channel]
        begin = chunk.message_index_offsets[channel] - chunk.chunk_start_offset + _INDEX_HEAD
        places.append(np.frombuffer(stored, "<i8", 2 * count, begin)[1::2])
        channels.append(np.full(count, channel))
    record = np.concatenate(places)
    order = np.argsort(record, kind="stable")
    return np.concatenate(channels)[order], record[order]


def _walk(content: bytes, position: Mapping[int, int]) -> tuple[IntArray, IntArray]:
    """Return what `_read_index` does of a chunk that has no index."""
    found = [
        (int.from_bytes(content[place : place + 2], "little"), place - RECORD_HEAD)
        for kind, place, size in records(BytesIO(content), 0, len(content))
        if kind == _MESSAGE
    ]
    chosen = np.array([each for each in found if each[0] in position], dtype=np.int64).reshape(-1, 2)
    return chosen[:, 0], chosen[:, 1]


class McapBlockWriter(McapWriter):
    """The mcap writer of rosbags that takes many messages at once, and writes them as chunks, all with CRCs."""

    def close_chunk(self) -> None:
        """Write the chunk of single messages, with its CRC."""
        begin, crc = self.bio.tell(), crc32(self.chunk.bio.getvalue())
        super().close_chunk()
        end = self.bio.tell()
        self.bio.seek(begin + _CHECKSUM)
        self.bio.write(crc.to_bytes(4, "little"))
        self.bio.seek(end)

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

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id."""
        number = np.cumsum(messages.size + _RECORD.itemsize) // CHUNK_BYTES
        bounds = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(messages)]
        for first, last in pairwise(bounds):
            self._write_chunk(messages.take(slice(first, last)))

    def _write_chunk(self, messages: RawMessages) -> None:
        content, offsets = self._lay_out(messages)
        span = int(messages.recorded_ns.min()), int(messages.recorded_ns.max())
        begin = self.bio.tell()
        size, crc = len(content), crc32(content.data)
        self.bio.write(struct.pack("<BQQQQIIQ", _CHUNK, _CHUNK_FIELDS + size, *span, size, crc, 0, size))
        self.bio.write(content.data)
        end = self.bio.tell()
        indices = self._write_index(messages, offsets)
        index = BytesIO()
        index.write(struct.pack("<QQQQI", *span, begin, end - begin, 10 * len(indices)))
        index.write(b"".join(struct.pack("<HQ", *each) for each in indices))
        index.write(struct.pack("<QIQQ", self.bio.tell() - end, 0, len(content), len(content)))
        self.chunks.append(index)
        self.message_start_time = min(self.message_start_time, span[0])
        self.message_end_time = max(self.message_end_time, span[1])

    def _lay_out(self, messages: RawMessages) -> tuple[ByteArray, IntArray]:
        """Return the content of a chunk, which begins with new types and topics, and where its records begin."""
        written = np.frombuffer(self.chunk.bio.getvalue(), np.uint8)
        self.chunk.bio = BytesIO()
        size = messages.size + _RECORD.itemsize
        offsets = len(written) + np.cumsum(size) - size
        content = np.empty(len(written) + int(size.sum()), np.uint8)
        content[: len(written)] = written
        _lay_records(content, offsets, messages)
        return content, offsets

    def _write_index(self, messages: RawMessages, offsets: IntArray) -> list[tuple[int, int]]:
        """Write where the messages of each channel are, and return where that is written."""
        places = []
        for channel in np.unique(messages.connection).tolist():
            places.append((channel, self.bio.tell()))
            chosen = messages.connection == channel
            entries = np.column_stack([messages.recorded_ns[chosen], offsets[chosen]]).astype("<u8")
            self.bio.write(struct.pack("<BQHI", _INDEX, 6 + entries.nbytes, channel, entries.nbytes))
            self.bio.write(entries.data)
            self.channel_stats[channel] += len(entries)
        return places


def _lay_records(content: ByteArray, places: IntArray, messages: RawMessages) -> None:
    """Put the records of messages at their places in the content of a chunk."""
    heads = np.zeros(len(messages), _RECORD)
    heads["kind"], heads["size"] = _MESSAGE, messages.size + _SIZE_BEYOND_MESSAGE
    heads["channel"], heads["log_ns"] = messages.connection, messages.recorded_ns
    heads["publish_ns"] = messages.recorded_ns
    windows(content, _RECORD.itemsize)[places] = heads.view(f"V{_RECORD.itemsize}")
    for size in np.unique(messages.size).tolist():
        chosen = np.flatnonzero(messages.size == size)
        if size:
            begins = places[chosen] + _RECORD.itemsize
            windows(content, size)[begins] = windows(messages.block, size)[messages.start[chosen]]


READER, WRITER, GUARD = BoundedMcapReader, McapBlockWriter, McapGuard
