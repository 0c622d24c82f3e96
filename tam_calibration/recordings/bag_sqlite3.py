"""The storage sqlite3: many rows read by one query, within bounds that SQLite keeps, or written with their CRCs."""

import os
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, suppress
from glob import escape
from pathlib import Path
from struct import Struct
from typing import Any, cast
from urllib.parse import quote
from zlib import crc32

import apsw
import numpy as np
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2 import CompressionMode
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer

from tam_calibration.files.text_files import temporary_place, unfinished
from tam_calibration.messages.cdr import RawMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_bounds import LARGEST_PIECE, Damaged, check_topics, quality_of
from tam_calibration.recordings.bag_storages import STORAGES, Condition, StoredFile, numbers_of

LOGS = ("-wal", "-journal")
"""Suffixes of the files that SQLite keeps next to a database while it is written to."""

_CRC_COLUMN = "crc32"
"""Of the table of messages, in files that this package wrote; other readers ignore it."""

_STEPS = 100_000
"""Steps of SQLite's virtual machine between two looks at signals and the bound, some milliseconds."""

_FREE_STEPS, _STEPS_A_BYTE = 10_000_000, 10
"""Steps that any file may take, about a second, and further ones for each of its bytes: reading takes less than 1."""


ROWS, _BYTES = 8_192, 2_000_000
"""Most rows, and bytes of messages of mean size, that a query gathers: larger blocks leave the processor's caches."""

_HEAD = Struct(">16sH6xII60xI4x")
"""Head of a file: mark, size of a page, number of the last change, pages, and the change that these are of."""
_INDEX = "timestamp_idx"
_TABLES = "('topics', 'messages', 'message_definitions')"
_UNUSUAL = f"""
SELECT name FROM pragma_table_list AS tables WHERE schema = 'main' AND lower(name) IN {_TABLES} AND (
    type != 'table' OR EXISTS (SELECT 1 FROM pragma_table_xinfo(tables.name) WHERE hidden) OR EXISTS (
        SELECT 1 FROM pragma_index_list(tables.name) AS i, pragma_index_xinfo(i.name) AS x WHERE x.cid = -2))
"""
"""Views, virtual tables, and tables with generated columns or indexed expressions: reading them runs what they say."""

_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_IS_MESSAGE = "typeof(data) = 'blob' AND typeof(timestamp) = 'integer'"
_FITS_CRC = f"ifnull({_CRC_COLUMN} = crc(data, crc(CAST(topic_id || ' ' || timestamp AS BLOB))), 1)"
"""Whether a row has the CRC that is stored with it, if there is one."""

_SPAN = """
SELECT (SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages), (SELECT count(*) FROM messages)
"""
_INSERT = f"INSERT INTO messages (topic_id, timestamp, data, {_CRC_COLUMN}) VALUES(?, ?, ?, ?)"
_NEXT = f"""
SELECT timestamp FROM messages INDEXED BY {_INDEX} WHERE timestamp >= ? ORDER BY timestamp LIMIT 1 OFFSET ?
"""
_GATHER = f"""
SELECT group_concat(topic_id), group_concat(timestamp - ?1), group_concat(length(data)),
    CAST(group_concat(data, '') AS BLOB)
FROM messages INDEXED BY {_INDEX} WHERE timestamp >= ?1 AND timestamp < ?2
"""
"""Goes along the index, which is in the order of recording; named, it is taken without sorting what it gives."""

_HAS_INDEX = f"""
SELECT 1 FROM pragma_index_list('messages') AS i WHERE name = '{_INDEX}' AND NOT partial
    AND (SELECT group_concat(name) FROM pragma_index_info(i.name)) = 'timestamp'
"""


def in_uri(path: Path) -> str:
    """Return a path as a URI has it: a ``?``, ``#`` or ``%`` in a name would mean something else there."""
    return quote(os.fsencode(path))


def _open(path: Path, words: str = "?immutable=1", flags: int = apsw.SQLITE_OPEN_READONLY) -> apsw.Connection:
    """Open a database whose schema is not trusted, and whose queries end."""
    database = apsw.Connection(f"file:{in_uri(path.absolute())}{words}", flags=flags | apsw.SQLITE_OPEN_URI)
    database.config(apsw.SQLITE_DBCONFIG_TRUSTED_SCHEMA, 0)
    database.config(apsw.SQLITE_DBCONFIG_ENABLE_VIEW, 0)
    database.limit(apsw.SQLITE_LIMIT_LENGTH, LARGEST_PIECE)
    # Statements and definitions of bags have some hundred bytes.
    database.limit(apsw.SQLITE_LIMIT_SQL_LENGTH, 1 << 20)
    size = sum(file.stat().st_size for file in path.parent.glob(f"{escape(path.name)}*"))
    left = iter(range(int(_FREE_STEPS + _STEPS_A_BYTE * size) // _STEPS))

    def is_too_much() -> bool:  # Python handles signals here
        if next(left, None) is None:
            raise InputError("SQLite needs more steps for it than for any recording of its size")
        return False

    database.create_scalar_function("crc", cast(Any, crc32), deterministic=True)
    database.set_progress_handler(is_too_much, _STEPS)
    for guard in ("cell_size_check", "ignore_check_constraints"):
        database.execute(f"PRAGMA {guard} = ON")
    return database


def _require_plain(database: apsw.Connection) -> None:
    """Check that a database has the tables of a bag, of plain rows, and no more topics than are read."""
    if unusual := _first(database, _UNUSUAL):
        raise InputError(f"{unusual[0]} is no plain table as in a bag: it is a view or computes its values")
    if _first(database, "SELECT count(*) FROM sqlite_master WHERE name IN ('topics', 'messages')") != (2,):
        raise Damaged("it lacks the tables topics and messages of a bag")
    check_topics(_first(database, "SELECT count(*) FROM topics")[0])


def _first(database: apsw.Connection, query: str, *values: int) -> Any:
    return next(iter(database.execute(query, values)), None)


def _read_connections(database: apsw.Connection) -> list[Connection]:
    """Return the topics of a database of any distribution of ROS 2."""
    has_definitions = _first(database, "SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'")
    kinds = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
    rows = database.execute(_DEFINITIONS) if has_definitions else ()
    definitions = {name: MessageDefinition(kinds[kind], text) for name, kind, text in rows if kind in kinds}
    columns = [column for _, column, *_ in database.execute("PRAGMA table_info(topics)")]
    unknown = MessageDefinition(MessageDefinitionFormat.NONE, "")
    connections = []
    for row in database.execute("SELECT * FROM topics ORDER BY id"):
        topic = dict(zip(columns, row, strict=True))
        quality = quality_of(str(topic.get("offered_qos_profiles", "")))
        extra = ConnectionExtRosbag2(topic["serialization_format"], quality)
        named = topic["id"], topic["name"], topic["type"], definitions.get(topic["type"], unknown)
        connections.append(Connection(*named, topic.get("type_description_hash", ""), 0, extra, database))
    return connections


class Sqlite3File(StoredFile):
    """A finished database.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        with closing(_open(path)) as database:
            _require_plain(database)
            counts = dict[int, int](database.execute("SELECT topic_id, count(*) FROM messages GROUP BY topic_id"))
            connections = [one._replace(msgcount=counts.get(one.id, 0)) for one in _read_connections(database)]
            first, last, count = _first(database, _SPAN)
        super().__init__(path, connections, first or 0, last or 0)
        self.message_count = count  # also those of topics that are missing

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield messages row by row, as of `StoredFile`."""
        with closing(_open(self.path)) as database:
            rows = database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp")
            yield from (row for row in rows if row[0] in ids)

    def blocks(self, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
        """Yield messages as of `StoredFile`; the database itself joins many rows, which spares an object for each."""
        is_all = len(position) == len(self.connections)
        query = _GATHER if is_all else f"{_GATHER} AND topic_id IN ({','.join(map(str, position))})"
        number = numbers_of(position)
        size, first, last, count = self.path.stat().st_size, self.start_ns, self.end_ns, self.message_count
        rows = max(min(ROWS, _BYTES * count // size), 1)
        with closing(_open(self.path)) as database:
            if not _first(database, _HAS_INDEX):  # somebody dropped it
                yield from super().blocks(position)
                return
            while first <= last:
                following = _first(database, _NEXT, first, rows)
                end = max(following[0], first + 1) if following else last + 1
                *numbers, block = _first(database, query, first, end)
                if block is not None:
                    topics, times, sizes = (np.fromstring(each, dtype=np.int64, sep=",") for each in numbers)
                    if int(sizes.sum()) != len(block):
                        raise Damaged("the sizes of its messages are not those of their bytes")
                    starts, content = np.cumsum(sizes) - sizes, np.frombuffer(block, np.uint8)
                    yield RawMessages(number[topics], first + times, starts, sizes, content), size * rows // count
                first = end


def condition_of(path: Path) -> Condition:
    """Return how a file was left, as of `RegisteredStorage`, by the checks of SQLite and the CRC of each message."""
    if _logs(path) or _is_cut(path):
        return Condition.UNFINISHED
    with closing(_open(path)) as database:
        _require_plain(database)
        for table in ("topics", "messages"):  # what is wrong elsewhere is no matter
            (answer,) = _first(database, f"PRAGMA integrity_check({table})")
            if answer != "ok":
                raise Damaged(f"SQLite finds {' '.join(str(answer or 'it malformed').split())}")
        topic = "(SELECT name FROM topics WHERE id = topic_id)"
        query = f"SELECT id, {topic}, timestamp / 1e9 FROM messages WHERE NOT {_is_intact(database)} LIMIT 1"
        for number, name, recorded_s in database.execute(query):
            raise Damaged(f"message {number} is damaged, of {name} at {recorded_s:.3f} s")
    return Condition.COMPLETE


def _is_cut(path: Path) -> bool:
    """Return whether a file is not as long as it says."""
    head, mark = _begin(path, _HEAD.size), STORAGES["sqlite3"].beginning
    if head[: len(mark)] != mark[: len(head)]:
        return False
    if len(head) < _HEAD.size:
        return True
    _, size, change, stated, change_of_stated = _HEAD.unpack(head)
    pages, rest = divmod(path.stat().st_size, 1 << 16 if size == 1 else max(size, 512))
    return rest != 0 or (change == change_of_stated and pages != stated)


def _logs(path: Path) -> list[Path]:
    """Return the journals that SQLite left next to a file; one that begins with zeros is obsolete."""
    logs = [path.with_name(path.name + suffix) for suffix in LOGS]
    return [log for log in logs if log.is_file() and _begin(log, 1) > b"\0"]


def _begin(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


def _is_intact(database: apsw.Connection) -> str:
    """Return SQL that tells whether a row of a database is a message as it was written."""
    has_crc = _CRC_COLUMN in [name for _, name, *_ in database.execute("PRAGMA table_info(messages)")]
    return f"CASE WHEN {_IS_MESSAGE} THEN {_FITS_CRC if has_crc else 1} ELSE 0 END"


def complete_messages(path: Path, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield what SQLite can read of a file, finished or not, as of `RegisteredStorage`.

    The file is copied with its journals, which SQLite then plays back. Rows that it cannot reach are left out.

    Parameters
    ----------
    path : Path
        The file, which is never written to.
    faults : list of str
        Each message that is left out is added, as a clause.
    """
    with unfinished(temporary_place()) as folder:
        copy = folder / "copy.db3"
        for source in (path, *_logs(path)):
            shutil.copyfile(source, folder / f"{copy.name}{source.name[len(path.name) :]}")
        with suppress(apsw.Error, Damaged), closing(_open(copy, "", apsw.SQLITE_OPEN_READWRITE)) as database:
            database.execute("PRAGMA writable_schema = ON")  # else what is gone of the schema or the end hides the rest
            _require_plain(database)
            connections = {one.id: one for one in _read_connections(database)}
            is_cut = _is_cut(path)
            for number, topic, recorded_ns, message, is_complete in _rows(database, None if is_cut else faults):
                if topic in connections and is_complete:
                    yield connections[topic], recorded_ns, message
                elif is_cut:
                    return
                else:
                    faults.append(f"message {number} is damaged")


def _rows(database: apsw.Connection, faults: list[str] | None) -> Iterator[tuple[int, int, int, bytes, int]]:
    """Yield the rows that SQLite can read, those behind damaged pages too where faults are listed."""
    query = f"SELECT id, topic_id, timestamp, data, {_is_intact(database)} FROM messages NOT INDEXED WHERE id > ?"
    last, stride = -1, 1
    while last < 1 << 62:
        try:
            for row in database.execute(f"{query} ORDER BY id", (last,)):
                last, stride = row[0], 1
                yield row
            return
        except apsw.Error:
            if faults is None:
                return
            if stride == 1:
                faults.append(f"SQLite cannot read on behind message {last}")
            last, stride = last + stride, stride + 1 + stride // 8


class Sqlite3BlockWriter(Sqlite3Writer):
    """The sqlite3 writer of rosbags, with the CRC of each message; their index is made when all are there."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        super().__init__(Path(in_uri(path)), compression)
        self.path = path / f"{path.name}.db3"
        # A file that fails is removed: no journal is needed.
        self.conn.executescript(
            "PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF; "
            f"DROP INDEX {_INDEX}; ALTER TABLE messages ADD COLUMN {_CRC_COLUMN} INTEGER;"
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
        self.write_block(RawMessages.of([connection.id], [timestamp], [bytes(data)]))

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id, in their order.

        Parameters
        ----------
        messages : RawMessages
            Their connections are ids of this writer's.
        """
        rows = zip(messages.connection.tolist(), messages.recorded_ns.tolist(), messages.messages(), strict=True)
        # As _FITS_CRC has it.
        self.cursor.executemany(
            _INSERT,
            ((number, time_ns, one, crc32(one, crc32(b"%d %d" % (number, time_ns)))) for number, time_ns, one in rows),
        )


FILE, WRITER = Sqlite3File, Sqlite3BlockWriter
