"""What is whole in an mcap file, by its CRCs and its records, as the specification of MCAP lays them out."""

import struct
from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2.storage_mcap import Schema, get_msgdef, get_qos, read_bytes, read_string

from tam_calibration.files.bag_bounds import check_piece, check_topic, unpack, unpack_beginning
from tam_calibration.files.bag_damage import Damage, describe
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import IntArray

MAGIC = b"\x89MCAP0\r\n"

_FOOTER, _SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _INDEX, _DATA_END = 2, 3, 4, 5, 6, 7, 15
"""Kinds of records."""

_HEAD = struct.Struct("<BQ")

RECORD_HEAD = _HEAD.size
"""Bytes of kind and size before the content of a record."""

_END = struct.Struct("<BQQQI8s")
"""The end of a file: footer with places of summary and summary offsets, CRC of both, and magic."""

_DATA_END_RECORD = struct.Struct("<BQI")
_CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
_INDEX_HEAD = struct.Struct("<HI")

_BLOCK = 1 << 20


def seal(path: Path) -> None:
    """Put the CRCs of data section and summary into a file that was written without."""
    with path.open("r+b") as file:
        end = file.seek(-_END.size, 2)
        kind, size, summary, offsets, _, magic = _END.unpack(file.read())
        data_end = summary - _DATA_END_RECORD.size
        data_crc = _crc(file, 0, data_end)
        file.seek(data_end)
        file.write(_DATA_END_RECORD.pack(_DATA_END, 4, data_crc))
        footer = _END.pack(kind, size, summary, offsets, 0, magic)
        summary_crc = crc32(footer[: -len(MAGIC) - 4], _crc(file, summary, end))
        file.seek(end)
        file.write(_END.pack(kind, size, summary, offsets, summary_crc, magic))


class McapGuard:
    """Tells of an mcap file whether it is finished and whole, and which of its messages are.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._schemas: dict[int, Schema] = {}
        self._connections: dict[int, Connection] = {}

    def is_unfinished(self) -> bool:
        """Return whether the file begins as mcap does and lacks the end."""
        with self._path.open("rb") as file:
            beginning = file.read(len(MAGIC))
            return beginning == MAGIC[: len(beginning)] and _read_end(file) is None

    def find_damage(self) -> str:
        """Return what is damaged by the CRCs of summary and data section, as a clause; nothing where all fits."""
        with self._path.open("rb") as file:
            found = _read_end(file)
            if found is None:
                return "its end is missing"
            end, (summary, offsets, summary_crc) = found
            if summary and not len(MAGIC) <= summary <= end:
                return "its summary lies outside"
            begin = summary or end
            footer = _END.pack(_FOOTER, 20, summary, offsets, 0, MAGIC)[: -len(MAGIC) - 4]
            if summary_crc and crc32(footer, _crc(file, begin, end)) != summary_crc:
                return "its summary does not fit its CRC"
            if any(place + size > end for _, place, size in records(file, begin, end)):
                return "its summary is cut"
            file.seek(begin - _DATA_END_RECORD.size)
            kind, _, data_crc = _DATA_END_RECORD.unpack(file.read(_DATA_END_RECORD.size))
            if kind != _DATA_END or not data_crc or _crc(file, 0, begin - _DATA_END_RECORD.size) == data_crc:
                return ""
        return self.damaged_messages() or "it does not fit its CRC, though all messages do"

    def damaged_messages(self) -> str:
        """Return a clause that names the messages of the chunks that do not fit their CRC."""
        topics: dict[int, str] = {}
        damaged: list[tuple[int, Damage]] = []
        counts: Counter[int] = Counter()
        is_whole = True
        end = self._path.stat().st_size
        with self._path.open("rb") as file:
            for kind, place, size in records(file, len(MAGIC), end):
                if place + size > end:
                    break
                if kind == _CHUNK:
                    chunk = _read_chunk(file, place, size)
                    is_whole = chunk is not None and _unpacked(chunk) is not None
                elif kind == _INDEX:
                    channel, times = _read_index(file, place, size)
                    first, counts[channel] = counts[channel] + 1, counts[channel] + len(times)
                    if not is_whole and len(times):
                        span = int(times.min()), int(times.max())
                        damaged.append((channel, Damage("", first, counts[channel], *span)))
                elif kind == _CHANNEL:
                    channel, _, topic, *_ = _parse_channel(_content(file, place, size))
                    topics[channel] = topic
        return describe([each._replace(topic=topics.get(channel, f"{channel}")) for channel, each in damaged])

    def whole_messages(self, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording in nanoseconds and serialised message, as they stand in the file.

        Parameters
        ----------
        faults : list of str
            What was left out is added to it, in clauses.

        Raises
        ------
        InputError
            When the file is not mcap, or something in it is larger than it may be.
        """
        end = self._path.stat().st_size
        with self._path.open("rb") as file:
            beginning = file.read(len(MAGIC))
            if beginning != MAGIC[: len(beginning)]:
                raise InputError(f"{self._path.name} does not begin as an mcap file does")
            for record in records(file, len(MAGIC), end):  # the summary knows the topics of a chunk that is damaged
                self._learn(file, *record, end)
            yield from self._walk(file, len(MAGIC), end, faults)

    def _walk(
        self, stream: BinaryIO, begin: int, end: int, faults: list[str], in_chunk: bool = False
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield messages; the last not where room follows that was never written to, as its end may lack too."""
        held: list[tuple[Connection, int, bytes]] = []
        reached = begin
        for kind, place, size in records(stream, begin, end):
            yield from held
            held, reached = [], place + size
            if kind == _CHUNK and not in_chunk:
                content = _whole_part(_read_chunk(stream, place, min(size, end - place)), place, faults)
                yield from self._walk(BytesIO(content), 0, len(content), faults, in_chunk=True)
            if kind == _DATA_END or reached > end:
                return
            self._learn(stream, kind, place, size, end)
            if kind == _MESSAGE and size >= _MESSAGE_HEAD.size:
                content = _content(stream, place, size)
                channel, _, recorded_ns, _ = _MESSAGE_HEAD.unpack_from(content)
                if channel in self._connections:
                    held = [(self._connections[channel], recorded_ns, content[_MESSAGE_HEAD.size :])]
        if reached + RECORD_HEAD > end:
            yield from held

    def _learn(self, stream: BinaryIO, kind: int, place: int, size: int, end: int) -> None:
        """Take in the type or topic that a record tells, if that is what it does."""
        if kind not in (_SCHEMA, _CHANNEL) or place + size > end:
            return
        content = _content(stream, place, size)
        if kind == _SCHEMA:
            schema = _parse_schema(content)
            self._schemas[schema.id] = schema
            return
        check_topic(size)
        channel, schema_id, topic, encoding, metadata = _parse_channel(content)
        known = self._schemas.get(schema_id)
        name = "__schemaless__" if known is None else known.name
        extra = ConnectionExtRosbag2(encoding, get_qos(metadata))
        self._connections[channel] = Connection(channel, topic, name, get_msgdef(known), "", 0, extra, self)


def check_topics(stream: BinaryIO, begin: int, end: int) -> None:
    """Check `bag_bounds.check_topic` for all topics of a part of a file."""
    for kind, _, size in records(stream, begin, end):
        if kind == _CHANNEL:
            check_topic(size)


def _read_end(file: BinaryIO) -> tuple[int, tuple[int, int, int]] | None:
    """Return where the footer begins, and what it tells; None where there is none."""
    size = file.seek(0, 2)
    if size < _END.size:
        return None
    begin = file.seek(-_END.size, 2)
    kind, length, summary, offsets, crc, magic = _END.unpack(file.read())
    return (begin, (summary, offsets, crc)) if (kind, length, magic) == (_FOOTER, 20, MAGIC) else None


def _crc(file: BinaryIO, begin: int, end: int) -> int:
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


def _content(stream: BinaryIO, place: int, size: int) -> bytes:
    check_piece(size, size, "a record")
    stream.seek(place)
    return stream.read(size)


class _Chunk(NamedTuple):
    """A chunk as it is stored, cut where ``packed`` is shorter than ``packed_size``."""

    size: int
    crc: int
    compression: str
    packed_size: int
    packed: bytes


def _read_chunk(stream: BinaryIO, place: int, size: int) -> _Chunk | None:
    """Return the chunk in a record, of which so many bytes are there; None where it lacks its head."""
    content = BytesIO(_content(stream, place, size))
    try:
        _, _, unpacked, crc = _CHUNK_HEAD.unpack(content.read(_CHUNK_HEAD.size))
        compression = read_string(content)
        packed_size = int.from_bytes(content.read(8), "little")
    except Exception:  # of struct, of rosbags, or no UTF-8
        return None
    return _Chunk(unpacked, crc, compression, packed_size, content.read(packed_size if packed_size < size else size))


def _unpacked(chunk: _Chunk) -> bytes | None:
    """Return what a chunk holds; None where it is damaged."""
    try:
        content = unpack(chunk.packed, chunk.compression, chunk.size)
    except Exception:  # whatever the decompressors raise
        return None
    return None if chunk.crc and crc32(content) != chunk.crc else content


def _whole_part(chunk: _Chunk | None, place: int, faults: list[str]) -> bytes:
    """Return what is whole in a chunk: all, nothing, or where it was cut the beginning."""
    if chunk is None:
        return b""
    check_piece(chunk.packed_size, chunk.size, "a chunk")
    if len(chunk.packed) == chunk.packed_size:
        content = _unpacked(chunk)
        if content is None:
            faults.append(f"the chunk at byte {place} is damaged")
        return content or b""
    try:
        return unpack_beginning(chunk.packed, chunk.compression, chunk.size)
    except Exception:  # whatever the decompressors raise
        return b""


def _read_index(file: BinaryIO, place: int, size: int) -> tuple[int, IntArray]:
    """Return a channel, and the times of its messages in the chunk before."""
    content = _content(file, place, size)
    channel, length = _INDEX_HEAD.unpack_from(content)
    entries: IntArray = np.frombuffer(content, "<i8", min(length, size - _INDEX_HEAD.size) // 16 * 2, _INDEX_HEAD.size)
    return channel, entries[::2]


def _parse_schema(content: bytes) -> Schema:
    stream = BytesIO(content)
    return Schema(int.from_bytes(stream.read(2), "little"), *(read_string(stream) for _ in range(3)))


def _parse_channel(content: bytes) -> tuple[int, int, str, str, bytes]:
    """Return number, number of its schema, topic, encoding of its messages and metadata."""
    stream = BytesIO(content)
    channel, schema = struct.unpack("<HH", stream.read(4))
    return channel, schema, read_string(stream), read_string(stream), read_bytes(stream)
