"""The storage sqlite3: files opened without counting their messages, many rows read by one query, or written."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import CompressionMode, ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader, Sqlite3Writer

from tam_calibration.files.sqlite3_guard import CRC_COLUMN, TABLES, Sqlite3Guard, crc_of, in_uri, read_connections
from tam_calibration.messages.cdr import NOT_READ, RawMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import IntArray

ROWS, _BYTES = 8_192, 2_000_000
"""How much a query gathers, at most rows, and bytes of messages of mean size: more leaves the caches."""

_SPAN = """
SELECT (SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages), (SELECT count(*) FROM messages)
"""
_INSERT = f"INSERT INTO messages (topic_id, timestamp, data, {CRC_COLUMN}) VALUES(?, ?, ?, ?)"
_NEXT = "SELECT timestamp FROM messages WHERE timestamp >= ? ORDER BY timestamp LIMIT 1 OFFSET ?"
_INDEX = "timestamp_idx"
_TIMES = "group_concat(timestamp - ?1)"
_GATHER = f"""
SELECT group_concat(topic_id), {_TIMES}, group_concat(length(data)), CAST(group_concat(data, '') AS BLOB)
FROM messages INDEXED BY {_INDEX} WHERE timestamp >= ?1 AND timestamp < ?2
"""
"""Goes along the index, which is in the order of recording; named, it is taken without sorting what it gives."""


class QuickSqlite3Reader(Sqlite3Reader):
    """The sqlite3 reader of rosbags, which opens a file without counting the messages of each topic.

    Counting takes as long as reading them; ``msgcount`` is 0 in its connections.
    """

    def open(self) -> None:
        """Open the file, whose name rosbags puts into a URI as it is."""
        path, self.path = self.path, Path(in_uri(Path(str(self.path))))
        try:
            super().open()
        finally:
            self.path = path

    def _open(self) -> None:
        tables = {name for (name,) in self._rows(TABLES)}
        if not {"topics", "messages"} <= tables:
            raise ReaderError(f"Cannot open database {self.path} or database missing tables.")
        self.connections = read_connections(self._rows, self)
        first, last, count = next(iter(self._rows(_SPAN)))
        if count:
            self.metadata = ReaderMetadata(last + 1 - first, first, last + 1, count, None, None, None, None)

    def _rows(self, query: str) -> Any:
        assert self.dbconn is not None
        return self.dbconn.execute(query)


def read_blocks(
    file: Sqlite3Reader, position: Mapping[int, int], with_times: bool
) -> Iterator[tuple[RawMessages, int]] | None:
    """Return blocks of messages as ``Storage`` asks; None where a file lacks the index by time that ROS writes.

    Parameters
    ----------
    file : Sqlite3Reader
        An open file.
    position : mapping of int to int
        For the id of each wanted connection the number that stands for it in the messages.
    with_times : bool
        Whether to read the times of recording, else they are ``NOT_READ``, which takes four fifths of the time.
    """
    has_index = _fetch(file, "SELECT 1 FROM sqlite_master WHERE type = 'index' AND name = ?", _INDEX) is not None
    return _rows(file, position, with_times) if has_index else None


def _rows(storage: Sqlite3Reader, position: Mapping[int, int], with_times: bool) -> Iterator[tuple[RawMessages, int]]:
    """Yield rows that the database itself joins, which spares an object for each."""
    is_all = len(position) == len(storage.connections)
    gather = _GATHER if is_all else f"{_GATHER} AND topic_id IN ({','.join(map(str, position))})"
    gather = gather if with_times else gather.replace(_TIMES, "NULL")
    number = np.zeros(max(position) + 1, dtype=np.int64)
    number[list(position)] = list(position.values())
    size = Path(str(storage.path)).stat().st_size
    first, last, count = _fetch(storage, _SPAN)
    rows = max(min(ROWS, _BYTES * count // size), 1) if count else 0
    while count and first <= last:
        following = _fetch(storage, _NEXT, first, rows)
        end = max(following[0], first + 1) if following else last + 1
        topics, times, sizes, block = _fetch(storage, gather, first, end)
        if block is not None:
            connection = number[_parse(topics)]
            recorded_ns = first + _parse(times) if with_times else np.full(len(connection), NOT_READ)
            yield _messages(connection, recorded_ns, _parse(sizes), block), size * rows // count
        first = end


def _fetch(storage: Sqlite3Reader, query: str, *values: int | str) -> Any:
    assert storage.dbconn is not None
    return next(iter(storage.dbconn.execute(query, values)), None)


def _parse(numbers: str) -> IntArray:
    return np.fromstring(numbers, dtype=np.int64, sep=",")


def _messages(connection: IntArray, recorded_ns: IntArray, size: IntArray, block: bytes) -> RawMessages:
    if int(size.sum()) != len(block):
        raise InputError("the sizes of its messages are not those of their bytes")
    return RawMessages(connection, recorded_ns, np.cumsum(size) - size, size, np.frombuffer(block, np.uint8))


class Sqlite3BlockWriter(Sqlite3Writer):
    """The sqlite3 writer of rosbags that takes many messages at once; their index is made when all are there.

    Beside each message stands its CRC.
    """

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(Path(in_uri(path)), compression)
        self.path = path / f"{path.name}.db3"
        # What fails is removed as a whole: no journal is needed to take back a part.
        self.conn.executescript(
            "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; "
            f"DROP INDEX {_INDEX}; ALTER TABLE messages ADD COLUMN {CRC_COLUMN} INTEGER;"
        )

    def close(self, version: int, metadata: str) -> None:
        """Make the index, and close the file.

        Parameters
        ----------
        version : int
            Of the bag's metadata.
        metadata : str
            What ``metadata.yaml`` of the bag says, kept in the file too.
        """
        self.cursor.execute(f"CREATE INDEX {_INDEX} ON messages (timestamp ASC)")
        super().close(version, metadata)

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id."""
        rows = zip(messages.connection.tolist(), messages.recorded_ns.tolist(), messages.messages(), strict=True)
        self.cursor.executemany(_INSERT, ((*row, crc_of(*row)) for row in rows))

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write one message.

        Parameters
        ----------
        connection : Connection
            Of this writer.
        timestamp : int
            Time of recording, nanoseconds.
        data : bytes
            The serialised message.
        """
        row = connection.id, timestamp, bytes(data)
        self.cursor.execute(_INSERT, (*row, crc_of(*row)))


READER, WRITER, GUARD = QuickSqlite3Reader, Sqlite3BlockWriter, Sqlite3Guard
