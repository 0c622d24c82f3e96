"""Writing many messages of a bag at once, through the writer of rosbags."""

import struct
from collections.abc import Mapping
from io import BytesIO
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionMode, StoragePlugin, Writer
from rosbags.rosbag2.storage_mcap import McapWriter
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from tam_calibration.files.bag_mcap import CHUNK, INDEX, MESSAGE, RECORD, SIZE_BEYOND_MESSAGE
from tam_calibration.messages.cdr import ByteArray, IntArray, RawMessages, windows

CHUNK_BYTES = 1 << 20

_CHUNK_HEAD = 40
_INDEX = "timestamp_idx"
_INSERT = "INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)"


class Sqlite3BlockWriter(Sqlite3Writer):
    """The sqlite3 writer of rosbags that takes many messages at once; their index is made when all are there."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(path, compression)
        # What fails is removed as a whole: no journal is needed to take back a part.
        self.conn.executescript(f"PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; DROP INDEX {_INDEX};")

    def close(self, version: int, metadata: str) -> None:
        """Make the index, and close the file."""
        self.cursor.execute(f"CREATE INDEX {_INDEX} ON messages (timestamp ASC)")
        super().close(version, metadata)

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id."""
        rows = zip(messages.connection.tolist(), messages.recorded_ns.tolist(), messages.messages(), strict=True)
        self.cursor.executemany(_INSERT, rows)


class McapBlockWriter(McapWriter):
    """The mcap writer of rosbags that takes many messages at once, and writes them as chunks."""

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id."""
        number = np.cumsum(messages.size + RECORD.itemsize) // CHUNK_BYTES
        bounds = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(messages)]
        for first, last in pairwise(bounds):
            self._write_chunk(messages.take(slice(first, last)))

    def _write_chunk(self, messages: RawMessages) -> None:
        content, offsets = self._lay_out(messages)
        span = int(messages.recorded_ns.min()), int(messages.recorded_ns.max())
        begin = self.bio.tell()
        self.bio.write(
            struct.pack("<BQQQQIIQ", CHUNK, _CHUNK_HEAD + len(content), *span, len(content), 0, 0, len(content))
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
        told = np.frombuffer(self.chunk.bio.getvalue(), np.uint8)
        self.chunk.bio = BytesIO()
        size = messages.size + RECORD.itemsize
        offsets = len(told) + np.cumsum(size) - size
        content = np.empty(len(told) + int(size.sum()), np.uint8)
        content[: len(told)] = told
        _lay_records(content, offsets, messages)
        return content, offsets

    def _write_index(self, messages: RawMessages, offsets: IntArray) -> list[tuple[int, int]]:
        """Write where the messages of each channel are, and return where that is written."""
        places = []
        for channel in np.unique(messages.connection).tolist():
            places.append((channel, self.bio.tell()))
            chosen = messages.connection == channel
            entries = np.column_stack([messages.recorded_ns[chosen], offsets[chosen]]).astype("<u8")
            self.bio.write(struct.pack("<BQHI", INDEX, 6 + entries.nbytes, channel, entries.nbytes))
            self.bio.write(entries.data)
            self.channel_stats[channel] += len(entries)
        return places


def _lay_records(content: ByteArray, places: IntArray, messages: RawMessages) -> None:
    """Put the records of messages at their places in the content of a chunk."""
    heads = np.zeros(len(messages), RECORD)
    heads["kind"], heads["size"] = MESSAGE, messages.size + SIZE_BEYOND_MESSAGE
    heads["channel"], heads["log_ns"] = messages.connection, messages.recorded_ns
    heads["publish_ns"] = messages.recorded_ns
    windows(content, RECORD.itemsize)[places] = heads.view(f"V{RECORD.itemsize}")
    for size in np.unique(messages.size).tolist():
        chosen = np.flatnonzero(messages.size == size)
        if size:
            begins = places[chosen] + RECORD.itemsize
            windows(content, size)[begins] = windows(messages.block, size)[messages.start[chosen]]


class BlockWriter(Writer):
    """The writer of rosbags that takes many messages at once beside single ones."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, type[Any]] = MappingProxyType(
        {StoragePlugin.SQLITE3: Sqlite3BlockWriter, StoragePlugin.MCAP: McapBlockWriter}
    )

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id, in their order.

        Parameters
        ----------
        messages : RawMessages
            Their connections are ids of this writer's.
        """
        if not len(messages):
            return
        assert isinstance(self.storage, Sqlite3BlockWriter | McapBlockWriter)
        self.storage.write_block(messages)
        for number, count in zip(*np.unique(messages.connection, return_counts=True), strict=True):
            self.counts[int(number)] += int(count)
        self.min_timestamp = min(int(messages.recorded_ns.min()), self.min_timestamp)
        self.max_timestamp = max(int(messages.recorded_ns.max()), self.max_timestamp)
