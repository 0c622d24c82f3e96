"""What is whole in an mcap file, by its CRCs and its records."""

from collections import Counter
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import BinaryIO
from zlib import crc32

from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2.storage_mcap import Schema, get_msgdef, get_qos

from tam_calibration.files.bag_bounds import check_topic
from tam_calibration.files.bag_damage import Damage, describe
from tam_calibration.files.mcap_records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    DATA_END_RECORD,
    END,
    FOOTER,
    INDEX,
    MAGIC,
    MESSAGE,
    MESSAGE_HEAD,
    RECORD_HEAD,
    SCHEMA,
    crc_of,
    parse_channel,
    parse_schema,
    read_chunk,
    read_content,
    read_end,
    read_index,
    records,
    unpack_chunk,
    whole_part,
)
from tam_calibration.model.exceptions import InputError


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
            return beginning == MAGIC[: len(beginning)] and read_end(file) is None

    def find_damage(self) -> str:
        """Return what is damaged by the CRCs of summary and data section, as a clause; nothing where all fits."""
        with self._path.open("rb") as file:
            found = read_end(file)
            if found is None:
                return "its end is missing"
            end, (summary, offsets, summary_crc) = found
            if summary and not len(MAGIC) <= summary <= end:
                return "its summary lies outside"
            begin = summary or end
            footer = END.pack(FOOTER, 20, summary, offsets, 0, MAGIC)[: -len(MAGIC) - 4]
            if summary_crc and crc32(footer, crc_of(file, begin, end)) != summary_crc:
                return "its summary does not fit its CRC"
            if any(place + size > end for _, place, size in records(file, begin, end)):
                return "its summary is cut"
            file.seek(begin - DATA_END_RECORD.size)
            kind, _, data_crc = DATA_END_RECORD.unpack(file.read(DATA_END_RECORD.size))
            if kind != DATA_END or not data_crc or crc_of(file, 0, begin - DATA_END_RECORD.size) == data_crc:
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
                if kind == CHUNK:
                    chunk = read_chunk(file, place, size)
                    is_whole = chunk is not None and unpack_chunk(chunk) is not None
                elif kind == INDEX:
                    channel, times = read_index(file, place, size)
                    first, counts[channel] = counts[channel] + 1, counts[channel] + len(times)
                    if not is_whole and len(times):
                        span = int(times.min()), int(times.max())
                        damaged.append((channel, Damage("", first, counts[channel], *span)))
                elif kind == CHANNEL:
                    channel, _, topic, *_ = parse_channel(read_content(file, place, size))
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
            if kind == CHUNK and not in_chunk:
                content = whole_part(read_chunk(stream, place, min(size, end - place)), place, faults)
                yield from self._walk(BytesIO(content), 0, len(content), faults, in_chunk=True)
            if kind == DATA_END or reached > end:
                return
            self._learn(stream, kind, place, size, end)
            if kind == MESSAGE and size >= MESSAGE_HEAD.size:
                content = read_content(stream, place, size)
                channel, _, recorded_ns, _ = MESSAGE_HEAD.unpack_from(content)
                if channel in self._connections:
                    held = [(self._connections[channel], recorded_ns, content[MESSAGE_HEAD.size :])]
        if reached + RECORD_HEAD > end:
            yield from held

    def _learn(self, stream: BinaryIO, kind: int, place: int, size: int, end: int) -> None:
        """Take in the type or topic that a record tells, if that is what it does."""
        if kind not in (SCHEMA, CHANNEL) or place + size > end:
            return
        content = read_content(stream, place, size)
        if kind == SCHEMA:
            schema = parse_schema(content)
            self._schemas[schema.id] = schema
            return
        check_topic(size)
        channel, schema_id, topic, encoding, metadata = parse_channel(content)
        known = self._schemas.get(schema_id)
        name = "__schemaless__" if known is None else known.name
        extra = ConnectionExtRosbag2(encoding, get_qos(metadata))
        self._connections[channel] = Connection(channel, topic, name, get_msgdef(known), "", 0, extra, self)
