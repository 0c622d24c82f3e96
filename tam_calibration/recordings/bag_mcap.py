"""The storage mcap: messages read chunk by chunk, by the index that follows each; chunks are written with CRCs."""

import struct
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Literal, NamedTuple
from zlib import crc32

import numpy as np
from rosbags.rosbag2.storage_mcap import McapWriter, read_bytes, read_string

from tam_calibration.messages.cdr import RawMessages, join, windows
from tam_calibration.model.units import IntArray
from tam_calibration.recordings import mcap_records
from tam_calibration.recordings.bag_bounds import NAMED, Damaged, check_piece, unpack
from tam_calibration.recordings.bag_storages import Condition, StoredFile, numbers_of
from tam_calibration.recordings.mcap_records import complete_messages

_RECORD = np.dtype(
    [("kind", "u1"), ("size", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log_ns", "<u8"), ("publish_ns", "<u8")]
)
"""Fields before the serialised message in the record of a message."""


_CHECKSUM, _CHUNK_HEAD, _INDEX_HEAD = 9 + 24, 9 + 40, 15


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
        self._chunks, topics, stated = list[_Chunk](), mcap_records.Topics(), None
        with path.open("rb") as file:
            end = mcap_records.read_end(file)
            for kind, place, size in mcap_records.records(file, end.summary, end.place) if end and end.summary else ():
                topics.learn(file, kind, place, size)
                if kind == mcap_records.CHUNK_INDEX:
                    self._chunks.append(_parse_chunk(mcap_records.read_content(file, place, size)))
                elif kind == mcap_records.STATISTICS:
                    stated = int.from_bytes(mcap_records.read_content(file, place, size)[:8], "little")
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
        check_piece(chunk.length, chunk.length, "a chunk with its index")
        file.seek(chunk.place)
        stored = file.read(chunk.length)
        begin = _CHUNK_HEAD + len(chunk.compression)
        check = int.from_bytes(stored[_CHECKSUM : _CHECKSUM + 4], "little")
        content = unpack(stored[begin : begin + chunk.packed_size], chunk.compression, chunk.size)
        if check and crc32(content) != check:
            raise Damaged(_named_damage(self.path))
        block = np.frombuffer(content, np.uint8)
        channel, record = _read_index(stored, chunk, position)
        if len(record) and int(record.max()) + _RECORD.itemsize > len(block):
            raise Damaged("the index of a chunk does not fit the chunk")
        heads = windows(block, _RECORD.itemsize)[record].view(_RECORD)
        start, size = record + _RECORD.itemsize, heads["size"].astype(np.int64) - 22  # its fields before the message
        is_message = (heads["kind"] == mcap_records.MESSAGE) & (heads["channel"] == channel)
        is_message &= np.diff(record, prepend=-1) > 0
        if not is_message.all() or (size < 0).any() or (start + size > len(block)).any():
            raise Damaged("the index of a chunk does not fit the chunk")
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
        channel: (begin - place + _INDEX_HEAD, end - begin - _INDEX_HEAD)
        for (begin, channel), end in zip(places, ends, strict=True)
        if end - begin > _INDEX_HEAD
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
        beginning = file.read(len(mcap_records.MAGIC))
        end = mcap_records.read_end(file)
        if end is None and beginning == mcap_records.MAGIC[: len(beginning)]:
            return Condition.UNFINISHED
        if end is None or beginning != mcap_records.MAGIC:
            raise Damaged("it does not begin as an mcap file does")
        if end.summary and not len(mcap_records.MAGIC) <= end.summary <= end.place:
            raise Damaged("its summary lies outside")
        if end.summary_crc not in (0, mcap_records.crc_of_summary(file, end)):
            raise Damaged("its summary does not fit its CRC")
        found, written = mcap_records.crc_of_data(file, end)
        if found != written:
            raise Damaged(_named_damage(path))
    return Condition.COMPLETE if McapFile(path).is_indexed else Condition.NOT_INDEXED


def _named_damage(path: Path) -> str:
    """Return what is damaged in a file whose data do not fit their CRC."""
    faults: list[str] = []
    deque(complete_messages(path, faults), maxlen=0)
    return "; ".join(faults[:NAMED]) or "it does not fit its CRC, though all messages do"


class McapBlockWriter(McapWriter):
    """The mcap writer of rosbags, with CRCs."""

    def close_chunk(self) -> None:
        """Write the chunk that is complete, with its CRC."""
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
        mcap_records.seal(self.path)


FILE, WRITER = McapFile, McapBlockWriter
