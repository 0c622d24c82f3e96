"""The records of an mcap file, as its specification lays them out."""

import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple
from zlib import crc32

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.storage_mcap import read_bytes, read_string
from rosbags.typesys.msg import normalize_msgtype

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_bounds import check_piece, check_topics, quality_of, unpack, unpack_beginning

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
    check_piece(size, size, "a record")
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
        extra = ConnectionExtRosbag2(encoding, quality_of(further.get("offered_qos_profiles", "")))
        digest = further.get("topic_type_hash", "")
        self.connections[number] = Connection(number, topic, name, definition, digest, 0, extra, self)
        check_topics(len(self.connections))


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
    footer: bytes


def read_end(file: BinaryIO) -> End | None:
    """Return the end of a file; None where it has none."""
    if file.seek(0, 2) < _END.size:
        return None
    place = file.seek(-_END.size, 2)
    content = file.read()
    kind, length, summary, _, crc, magic = _END.unpack(content)
    return End(place, summary, crc, content) if (kind, length, magic) == (FOOTER, 20, MAGIC) else None


def crc_of_data(file: BinaryIO, end: End) -> tuple[int, int]:
    """Return the CRC-32 of the data section of a file, and the one that is written there, 0 for none."""
    begin = (end.summary or end.place) - _DATA_END_RECORD.size
    file.seek(max(begin, 0))
    kind, _, written = _DATA_END_RECORD.unpack(file.read(_DATA_END_RECORD.size))
    return (_crc_of(file, 0, begin), written) if kind == DATA_END and written else (0, 0)


def crc_of_summary(file: BinaryIO, end: End) -> int:
    """Return the CRC-32 of the summary of a file, and of the footer as far as that goes before it."""
    return crc32(end.footer[: -len(MAGIC) - 4], _crc_of(file, end.summary or end.place, end.place))


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
    check_piece(packed_size, unpacked, "a chunk")
    try:
        if len(packed) < packed_size:
            return unpack_beginning(packed, compression, unpacked)
        content = unpack(packed, compression, unpacked)
        if crc in (0, crc32(content)):
            return content
    except Exception:  # whatever the decompressors raise
        if len(record) < size:
            return b""
    faults.append(f"the chunk at byte {place}, recorded at {first_ns / 1e9:.3f} s to {last_ns / 1e9:.3f} s, is damaged")
    return b""
