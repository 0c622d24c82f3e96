"""Messages of mcap files, chunk by chunk, by the index that follows each chunk."""

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from rosbags.rosbag2.storage_mcap import ChunkInfo, McapReader, decompress

from tam_calibration.messages.cdr import IntArray, RawMessages, join, windows
from tam_calibration.model.exceptions import InputError

RECORD = np.dtype(
    [("kind", "u1"), ("size", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
"""What stands before the serialised message in the record of a message."""

MESSAGE, CHUNK, INDEX = 5, 6, 7
"""Kinds of records."""

SIZE_BEYOND_MESSAGE = 22
"""Bytes of a record that its size counts beside the message."""

_CHECKSUM, _CHUNK_HEAD, _INDEX_HEAD = 9 + 24, 9 + 40, 15


def read_chunks(storage: McapReader, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of some channels, in the order of recording, and the bytes read for them.

    Parameters
    ----------
    storage : McapReader
        An open file.
    position : mapping
        For each channel that is read the number that stands for it.
    """
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
    if not len(record) or int(record.max()) + RECORD.itemsize > len(block):
        raise InputError("the index of a chunk does not fit the chunk")
    heads = windows(block, RECORD.itemsize)[record].view(RECORD)
    start, size = record + RECORD.itemsize, heads["size"].astype(np.int64) - SIZE_BEYOND_MESSAGE
    if (heads["kind"] != MESSAGE).any() or (size < 0).any() or (start + size > len(block)).any():
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
