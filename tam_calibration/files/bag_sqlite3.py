"""Messages of sqlite3 files: opened without counting them, and many rows read by one query."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2.metadata import ReaderMetadata, parse_qos
from rosbags.rosbag2.reader import DirectoryReader
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

from tam_calibration.messages.cdr import NOT_READ, IntArray, RawMessages
from tam_calibration.model.exceptions import InputError

ROWS, BYTES = 8_192, 2_000_000
"""How much a query gathers, at most rows, and bytes of messages of mean size: more leaves the caches."""

_SPAN = """
SELECT (SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages), (SELECT count(*) FROM messages)
"""
_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
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

    def _open(self) -> None:
        tables = {name for (name,) in self._rows("SELECT name FROM sqlite_master WHERE type = 'table'")}
        if not {"topics", "messages"} <= tables:
            raise ReaderError(f"Cannot open database {self.path} or database missing tables.")
        definitions = {}
        if "message_definitions" in tables:
            kinds = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
            definitions = {name: MessageDefinition(kinds[kind], text) for name, kind, text in self._rows(_DEFINITIONS)}
        columns = [column for _, column, *_ in self._rows("PRAGMA table_info(topics)")]
        topics = [dict(zip(columns, row, strict=True)) for row in self._rows("SELECT * FROM topics ORDER BY id")]
        unknown = MessageDefinition(MessageDefinitionFormat.NONE, "")
        self.connections = [
            Connection(
                topic["id"],
                topic["name"],
                topic["type"],
                definitions.get(topic["type"], unknown),
                topic.get("type_description_hash", ""),
                0,
                ConnectionExtRosbag2(topic["serialization_format"], parse_qos(topic.get("offered_qos_profiles", []))),
                self,
            )
            for topic in topics
        ]
        first, last, count = next(iter(self._rows(_SPAN)))
        if count:
            self.metadata = ReaderMetadata(last + 1 - first, first, last + 1, count, None, None, None, None)

    def _rows(self, query: str) -> Any:
        assert self.dbconn is not None
        return self.dbconn.execute(query)


class QuickDirectoryReader(DirectoryReader):
    """The reader of folders of rosbags, which opens sqlite3 files as above."""

    STORAGE_PLUGINS = MappingProxyType({**DirectoryReader.STORAGE_PLUGINS, "sqlite3": QuickSqlite3Reader})


class QuickReader(Reader):
    """The reader of rosbags, which opens sqlite3 files as above."""

    STORAGE_PLUGINS = MappingProxyType(
        {**Reader.STORAGE_PLUGINS, "dir": QuickDirectoryReader, ".db3": QuickSqlite3Reader}
    )


def has_index(storage: Sqlite3Reader) -> bool:
    """Return whether a file has the index by time that ``read_rows`` needs, as all have that ROS writes."""
    return _fetch(storage, "SELECT 1 FROM sqlite_master WHERE type = 'index' AND name = ?", _INDEX) is not None


def read_rows(
    storage: Sqlite3Reader, position: Mapping[int, int], with_times: bool
) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of some topics, in the order of recording, and the bytes read for them.

    The database itself joins rows, which spares an object for each.

    Parameters
    ----------
    storage : Sqlite3Reader
        An open file.
    position : mapping
        For each topic that is read the number that stands for it.
    with_times : bool
        Whether the times of recording are wanted, which take a fifth of the time.
    """
    is_all = len(position) == len(storage.connections)
    gather = _GATHER if is_all else f"{_GATHER} AND topic_id IN ({','.join(map(str, position))})"
    gather = gather if with_times else gather.replace(_TIMES, "NULL")
    number = np.zeros(max(position) + 1, dtype=np.int64)
    number[list(position)] = list(position.values())
    size = Path(str(storage.path)).stat().st_size
    first, last, count = _fetch(storage, _SPAN)
    rows = max(min(ROWS, BYTES * count // size), 1) if count else 0
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
