"""What is whole in a sqlite3 file, by its head, its journals, the check of SQLite and the CRC of each message."""

import os
import shutil
import sqlite3
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import quote
from zlib import crc32

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.metadata import parse_qos

from tam_calibration.files.bag_bounds import check_topic
from tam_calibration.files.bag_damage import Damage, describe
from tam_calibration.files.sqlite3_pages import DatabasePages, Row, page_size
from tam_calibration.files.whole_files import temporary_place, unfinished

CRC_COLUMN = "crc32"
"""Of the table of messages, in files that this package wrote; other readers ignore it."""

TABLES = "SELECT name FROM sqlite_master WHERE type = 'table'"

_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_NO_MESSAGE = "SELECT 1 FROM messages WHERE typeof(data) != 'blob' OR typeof(timestamp) != 'integer' LIMIT 1"
_BEGINNING = b"SQLite format 3\0"
_HEAD = 100
LOGS = ("-wal", "-journal")
"""Suffixes of what SQLite has beside a file as long as it is written to."""


def crc_of(topic: int, recorded_ns: int, message: bytes) -> int:
    """Return the CRC-32 that is stored with a message: of its topic's number, time of recording and bytes."""
    return crc32(message, crc32(b"%d %d" % (topic, recorded_ns)))


def read_connections(rows: Callable[[str], Any], owner: object) -> list[Connection]:
    """Return the topics of a database.

    Parameters
    ----------
    rows : callable
        Returns the rows of a query.
    owner : object
        Which the connections name as theirs.
    """
    definitions = {}
    if ("message_definitions",) in {tuple(row) for row in rows(TABLES)}:
        kinds = {"ros2msg": MessageDefinitionFormat.MSG, "ros2idl": MessageDefinitionFormat.IDL}
        definitions = {name: MessageDefinition(kinds[kind], text) for name, kind, text in rows(_DEFINITIONS)}
    columns = [column for _, column, *_ in rows("PRAGMA table_info(topics)")]
    topics = [dict(zip(columns, row, strict=True)) for row in rows("SELECT * FROM topics ORDER BY id")]
    for topic in topics:
        check_topic(len(str(topic.get("offered_qos_profiles"))))
    unknown = MessageDefinition(MessageDefinitionFormat.NONE, "")
    return [
        Connection(
            topic["id"],
            topic["name"],
            topic["type"],
            definitions.get(topic["type"], unknown),
            topic.get("type_description_hash", ""),
            0,
            ConnectionExtRosbag2(topic["serialization_format"], parse_qos(topic.get("offered_qos_profiles", []))),
            owner,
        )
        for topic in topics
    ]


class Sqlite3Guard:
    """Tells of a sqlite3 file whether it is finished and whole, and which of its messages are.

    Parameters
    ----------
    path : Path
        The file, which is never written to.
    """

    def __init__(self, path: Path) -> None:
        self._path = path

    def is_unfinished(self) -> bool:
        """Return whether a journal lies beside the file, or the file is not as long as it tells."""
        beginning = _begin(self._path, _HEAD)
        if beginning[: len(_BEGINNING)] != _BEGINNING[: len(beginning)]:
            return False
        if len(beginning) < _HEAD or self._logs():
            return True
        pages, rest = divmod(self._path.stat().st_size, page_size(beginning))
        is_current = beginning[24:28] == beginning[92:96]  # whether the number of pages is that of the last change
        return rest != 0 or (is_current and pages != int.from_bytes(beginning[28:32], "big"))

    def _logs(self) -> list[Path]:
        """Return what SQLite left beside the file; a journal that begins with zeros is done with."""
        logs = [self._path.with_name(self._path.name + suffix) for suffix in LOGS]
        return [log for log in logs if log.is_file() and _begin(log, 1) > b"\0"]

    def find_damage(self) -> str:
        """Return what SQLite and the CRC of each message find damaged, as a clause; nothing where all fits."""
        where = f"file:{in_uri(self._path.absolute())}?immutable=1"
        try:
            with closing(sqlite3.connect(where, uri=True)) as database:
                (answer,) = database.execute("PRAGMA integrity_check(1)").fetchone()
                damaged = "" if answer == "ok" else f"SQLite finds {' '.join(str(answer or 'it malformed').split())}"
                return describe(list(_damages(database))) or damaged
        except (sqlite3.Error, ValueError, TypeError, KeyError) as problem:
            return f"SQLite finds {' '.join(str(problem).split())}"

    def damaged_messages(self) -> str:
        """Return a clause that names the messages that do not fit their CRC."""
        return self.find_damage()

    def whole_messages(self, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording in nanoseconds and serialised message, in the order of writing.

        The file is copied with its journals, which SQLite then plays back. Where more lies on its pages than SQLite
        gives, of a transaction that was never ended or behind a page that is gone, that counts.

        Parameters
        ----------
        faults : list of str
            What was left out is added to it, in clauses.
        """
        with unfinished(temporary_place()) as folder:
            replayed, plain = folder / "replayed.db3", folder / "plain.db3"
            for source in (self._path, *self._logs()):
                shutil.copyfile(source, replayed.with_name(replayed.name + source.name[len(self._path.name) :]))
            pages = DatabasePages(self._path) if self.is_unfinished() else ()
            if isinstance(pages, tuple) or len(pages) <= _count(replayed):
                yield from _whole_rows(_read_connections(replayed), _rows(replayed), faults)
            else:
                shutil.copyfile(self._path, plain)
                _tell_true_size(plain)
                connections = _read_connections(plain) or _read_connections(replayed)
                yield from _whole_rows(connections, pages.rows(), faults)


def in_uri(path: Path) -> str:
    """Return a path as a URI has it: a ``?``, ``#`` or ``%`` in a name would mean something else there."""
    return quote(os.fsencode(path))


def _begin(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


def _tell_true_size(path: Path) -> None:
    """Have the head of a database tell as many pages as there are, or SQLite refuses those that it does not know of."""
    with path.open("r+b") as file:
        beginning = file.read(_HEAD)
        if len(beginning) < _HEAD:
            return
        file.seek(28)
        file.write((path.stat().st_size // page_size(beginning)).to_bytes(4, "big"))
        file.seek(92)
        file.write(beginning[24:28])


@contextmanager
def _opened(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a copy as far as SQLite can read it; what it cannot read ends what is done within."""
    with suppress(sqlite3.Error), closing(sqlite3.connect(path)) as database:
        yield database


def _count(path: Path) -> int:
    """Return how many messages of a database SQLite can read."""
    found = 0
    with _opened(path) as database:
        for _ in database.execute("SELECT id FROM messages ORDER BY id"):
            found += 1
    return found


def _read_connections(path: Path) -> dict[int, Connection]:
    with suppress(KeyError, TypeError), _opened(path) as database:  # of topics on a page that is gone
        database.execute("PRAGMA writable_schema = ON")  # else a table or an index that is gone hides the topics
        return {each.id: each for each in read_connections(database.execute, database)}
    return {}


def _rows(path: Path) -> Iterator[Row]:
    """Yield the rows of messages that SQLite can read."""
    with _opened(path) as database:
        crc = CRC_COLUMN if _has_crc(database) else "NULL"
        yield from database.execute(f"SELECT id, topic_id, timestamp, data, {crc} FROM messages ORDER BY id")


def _whole_rows(
    connections: Mapping[int, Connection], rows: Iterable[Row], faults: list[str]
) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield the messages of rows, without those that are none or do not fit their CRC."""
    for number, topic, recorded_ns, message, crc in rows:
        if topic in connections and _is_whole(topic, recorded_ns, message, crc):
            yield connections[topic], recorded_ns, message
        else:
            faults.append(f"message {number} is damaged")


def _is_whole(topic: Any, recorded_ns: Any, message: Any, crc: Any) -> bool:
    is_message = isinstance(recorded_ns, int) and isinstance(message, bytes)
    return is_message and crc in (None, crc_of(topic, recorded_ns, message))


def _has_crc(database: sqlite3.Connection) -> bool:
    return CRC_COLUMN in [name for _, name, *_ in database.execute("PRAGMA table_info(messages)")]


def _damages(database: sqlite3.Connection) -> Iterator[Damage]:
    """Yield the messages that are none, or do not fit their CRC."""
    has_crc = _has_crc(database)
    if not has_crc and database.execute(_NO_MESSAGE).fetchone() is None:
        return
    topics = dict(database.execute("SELECT id, name FROM topics"))
    numbers = {topic: count(1) for topic in topics}
    crc_column = CRC_COLUMN if has_crc else "NULL"
    query = f"SELECT topic_id, timestamp, data, {crc_column} FROM messages ORDER BY id"
    for topic, recorded_ns, message, crc in database.execute(query):
        number = next(numbers[topic])
        if not _is_whole(topic, recorded_ns, message, crc):
            time_ns = recorded_ns if isinstance(recorded_ns, int) else 0
            yield Damage(topics[topic], number, number, time_ns, time_ns)
