"""The storage mcap: messages read chunk by chunk, by the index that follows each, and written as chunks."""

import struct
from collections.abc import Iterator, Mapping
from io import BytesIO
from itertools import pairwise
from typing import Literal

import numpy as np
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, McapWriter, decompress

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


def read_blocks(
    file: McapReader, position: Mapping[int, int], with_times: bool
) -> Iterator[tuple[RawMessages, int]] | None:
    """Return blocks of messages as ``Storage`` asks; None where no chunk has an index.

    Parameters
    ----------
    file : McapReader
        An open file.
    position : mapping of int to int
        For the id of each wanted connection the number that stands for it in the messages.
    with_times : bool
        Makes no difference: the times of recording are always read.
    """
    return _chunks(file, position) if any(chunk.message_index_offsets for chunk in file.chunks) else None


def _chunks(storage: McapReader, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of each chunk that come before those of the next."""
    chunks = [chunk for chunk in storage.chunks if any(chunk.channel_count.get(channel) for channel in position)]
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
    storage.bio.seek(chunk.chunk_start_offset)
    stored = storage.bio.read(chunk.chunk_length + chunk.message_index_length)
    begin = _CHUNK_HEAD + len(chunk.compression)
    check = int.from_bytes(stored[_CHECKSUM : _CHECKSUM + 4], "little")
    packed = stored[begin : begin + chunk.compressed_size]
    block = np.frombuffer(decompress(packed, chunk.compression, chunk.uncompressed_size, check), np.uint8)
    record, number = _read_index(stored, chunk, position)
    if not len(record) or int(record.max()) + _RECORD.itemsize > len(block):
        raise InputError("the index of a chunk does not fit the chunk")
    heads = windows(block, _RECORD.itemsize)[record].view(_RECORD)
    start, size = record + _RECORD.itemsize, heads["size"].astype(np.int64) - _SIZE_BEYOND_MESSAGE
    if (heads["kind"] != _MESSAGE).any() or (size < 0).any() or (start + size > len(block)).any():
        raise InputError("the index of a chunk does not fit the chunk")
    messages = RawMessages(number, heads["log_ns"].astype(np.int64), start, size, block)
    is_in_order = bool((np.diff(messages.recorded_ns) >= 0).all())
    return messages if is_in_order else messages.take(np.argsort(messages.recorded_ns, kind="stable"))


def _read_index(stored: bytes, chunk: ChunkInfo, position: Mapping[int, int]) -> tuple[IntArray, IntArray]:
    """Return where the records of some channels begin in a chunk, rising, and the number of the channel of each."""
    records, numbers = [], []
    for channel, number in position.items():
        if count := chunk.channel_count.get(channel):
            begin = chunk.message_index_offsets[channel] - chunk.chunk_start_offset + _INDEX_HEAD
            records.append(np.frombuffer(stored, "<i8", 2 * count, begin)[1::2])
            numbers.append(np.full(count, number))
    record = np.concatenate(records)
    order = np.argsort(record, kind="stable")
    return record[order], np.concatenate(numbers)[order]


class McapBlockWriter(McapWriter):
    """The mcap writer of rosbags that takes many messages at once, and writes them as chunks."""

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
        self.bio.write(
            struct.pack("<BQQQQIIQ", _CHUNK, _CHUNK_FIELDS + len(content), *span, len(content), 0, 0, len(content))
        )
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


READER, WRITER = McapReader, McapBlockWriter
