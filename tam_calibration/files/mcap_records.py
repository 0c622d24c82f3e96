"""The records of an mcap file, as the specification of MCAP lays them out."""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

import numpy as np
from rosbags.rosbag2.storage_mcap import Schema, read_bytes, read_string

from tam_calibration.files.bag_bounds import check_piece, check_topic, unpack, unpack_beginning
from tam_calibration.model.units import IntArray

MAGIC = b"\x89MCAP0\r\n"

FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, DATA_END = 2, 3, 4, 5, 6, 7, 15
"""Kinds of records."""

_HEAD = struct.Struct("<BQ")

RECORD_HEAD = _HEAD.size
"""Bytes of kind and size before the content of a record."""

END = struct.Struct("<BQQQI8s")
"""The end of a file: footer with places of summary and summary offsets, CRC of both, and magic."""

_BLOCK = 1 << 20
"""Bytes that are read at once."""

DATA_END_RECORD = struct.Struct("<BQI")
_CHUNK_HEAD = struct.Struct("<QQQI")
MESSAGE_HEAD = struct.Struct("<HIQQ")
_INDEX_HEAD = struct.Struct("<HI")


def seal(path: Path) -> None:
    """Put the CRCs of data section and summary into a file that was written without."""
    with path.open("r+b") as file:
        end = file.seek(-END.size, 2)
        kind, size, summary, offsets, _, magic = END.unpack(file.read())
        data_end = summary - DATA_END_RECORD.size
        data_crc = crc_of(file, 0, data_end)
        file.seek(data_end)
        file.write(DATA_END_RECORD.pack(DATA_END, 4, data_crc))
        footer = END.pack(kind, size, summary, offsets, 0, magic)
        summary_crc = crc32(footer[: -len(MAGIC) - 4], crc_of(file, summary, end))
        file.seek(end)
        file.write(END.pack(kind, size, summary, offsets, summary_crc, magic))


def check_topics(stream: BinaryIO, begin: int, end: int) -> None:
    """Check `bag_bounds.check_topic` for all topics of a part of a file."""
    for kind, _, size in records(stream, begin, end):
        if kind == CHANNEL:
            check_topic(size)


def read_end(file: BinaryIO) -> tuple[int, tuple[int, int, int]] | None:
    """Return where the footer begins, and what it tells; None where there is none."""
    size = file.seek(0, 2)
    if size < END.size:
        return None
    begin = file.seek(-END.size, 2)
    kind, length, summary, offsets, crc, magic = END.unpack(file.read())
    return (begin, (summary, offsets, crc)) if (kind, length, magic) == (FOOTER, 20, MAGIC) else None


def crc_of(file: BinaryIO, begin: int, end: int) -> int:
    """Return the CRC-32 of a part of a file."""
    file.seek(begin)
    crc = 0
    while begin < end and (block := file.read(min(_BLOCK, end - begin))):
        crc, begin = crc32(block, crc), begin + len(block)
    return crc


def records(stream: BinaryIO, begin: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Yield kind of each record, and place and size of its content, which may reach beyond the end."""
    while begin + _HEAD.size <= end:
        stream.seek(begin)
        kind, size = _HEAD.unpack(stream.read(_HEAD.size))
        if not kind:  # room that was taken and never written to
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
    check_piece(size, size, "a record")
    stream.seek(place)
    return stream.read(size)


class Chunk(NamedTuple):
    """A chunk as it is stored, cut where ``packed`` is shorter than ``packed_size``."""

    size: int
    crc: int
    compression: str
    packed_size: int
    packed: bytes


def read_chunk(stream: BinaryIO, place: int, size: int) -> Chunk | None:
    """Return the chunk in a record, of which so many bytes are there; None where it lacks its head."""
    content = BytesIO(read_content(stream, place, size))
    try:
        _, _, unpacked, crc = _CHUNK_HEAD.unpack(content.read(_CHUNK_HEAD.size))
        compression = read_string(content)
        packed_size = int.from_bytes(content.read(8), "little")
    except Exception:  # of struct, of rosbags, or no UTF-8
        return None
    return Chunk(unpacked, crc, compression, packed_size, content.read(packed_size if packed_size < size else size))


def unpack_chunk(chunk: Chunk) -> bytes | None:
    """Return what a chunk holds; None where it is damaged."""
    try:
        content = unpack(chunk.packed, chunk.compression, chunk.size)
    except Exception:  # whatever the decompressors raise
        return None
    return None if chunk.crc and crc32(content) != chunk.crc else content


def whole_part(chunk: Chunk | None, place: int, faults: list[str]) -> bytes:
    """Return what is whole in a chunk: all, nothing, or where it was cut the beginning."""
    if chunk is None:
        return b""
    check_piece(chunk.packed_size, chunk.size, "a chunk")
    if len(chunk.packed) == chunk.packed_size:
        content = unpack_chunk(chunk)
        if content is None:
            faults.append(f"the chunk at byte {place} is damaged")
        return content or b""
    try:
        return unpack_beginning(chunk.packed, chunk.compression, chunk.size)
    except Exception:  # whatever the decompressors raise
        return b""


def read_index(file: BinaryIO, place: int, size: int) -> tuple[int, IntArray]:
    """Return a channel, and the times of its messages in the chunk before."""
    content = read_content(file, place, size)
    channel, length = _INDEX_HEAD.unpack_from(content)
    entries: IntArray = np.frombuffer(content, "<i8", min(length, size - _INDEX_HEAD.size) // 16 * 2, _INDEX_HEAD.size)
    return channel, entries[::2]


def parse_schema(content: bytes) -> Schema:
    """Return the type of messages that a record describes."""
    stream = BytesIO(content)
    return Schema(int.from_bytes(stream.read(2), "little"), *(read_string(stream) for _ in range(3)))


def parse_channel(content: bytes) -> tuple[int, int, str, str, bytes]:
    """Return number, number of its schema, topic, encoding of its messages and metadata."""
    stream = BytesIO(content)
    channel, schema = struct.unpack("<HH", stream.read(4))
    return channel, schema, read_string(stream), read_string(stream), read_bytes(stream)
