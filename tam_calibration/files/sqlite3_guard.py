"""What is whole in a sqlite3 file, by its head, its journals, the check of SQLite and the CRC of each message."""

import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from itertools import count
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple
from urllib.parse import quote
from zlib import crc32

from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinition, MessageDefinitionFormat
from rosbags.rosbag2.metadata import parse_qos

from tam_calibration.files.bag_damage import Damage, describe

CRC_COLUMN = "crc32"
"""Of the table of messages, in files that this package wrote; other readers ignore it."""

TABLES = "SELECT name FROM sqlite_master WHERE type = 'table'"

_DEFINITIONS = "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
_NO_MESSAGE = "SELECT 1 FROM messages WHERE typeof(data) != 'blob' OR typeof(timestamp) != 'integer' LIMIT 1"
_BEGINNING = b"SQLite format 3\0"
_HEAD = 100
_LOGS = ("-wal", "-journal")
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


class _Head(NamedTuple):
    """What the first bytes of a database tell: bytes a page, pages, and whether their number is of the last change."""

    page: int
    pages: int
    is_current: bool


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
        if not beginning.startswith(_BEGINNING):
            return False
        if len(beginning) < _HEAD or self._logs():
            return True
        head, size = _parse_head(beginning), self._path.stat().st_size
        return size % head.page != 0 or (head.is_current and size != head.page * head.pages)

    def _logs(self) -> list[Path]:
        """Return what SQLite left beside the file; a journal that begins with zeros is done with."""
        logs = [self._path.with_name(self._path.name + suffix) for suffix in _LOGS]
        return [log for log in logs if log.is_file() and _begin(log, 1) > b"\0"]

    def find_damage(self) -> str:
        """Return what SQLite and the CRC of each message find damaged, as a clause; nothing where all fits."""
        where = f"file:{quote(str(self._path.absolute()))}?immutable=1"
        try:
            with closing(sqlite3.connect(where, uri=True)) as database:
                (answer,) = database.execute("PRAGMA integrity_check(1)").fetchone()
                damaged = "" if answer == "ok" else f"SQLite finds {' '.join(str(answer).split())}"
                return describe(list(_damages(database))) or damaged
        except (sqlite3.Error, ValueError, TypeError, KeyError) as problem:
            return f"SQLite finds {' '.join(str(problem).split())}"

    def damaged_messages(self) -> str:
        """Return a clause that names the messages that do not fit their CRC."""
        return self.find_damage()

    def whole_messages(self, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
        """Yield connection, time of recording in nanoseconds and serialised message, in the order of writing.

        The file is copied: once with its journals, which SQLite then plays back, and once without, which gives more
        where a transaction was never ended. Of the second the messages count until one is missing.

        Parameters
        ----------
        faults : list of str
            What was left out is added to it, in clauses.
        """
        with TemporaryDirectory() as name:
            replayed, plain = Path(name, "replayed.db3"), Path(name, "plain.db3")
            for source in (self._path, *self._logs()):
                shutil.copyfile(source, replayed.with_name(replayed.name + source.name[len(self._path.name) :]))
            shutil.copyfile(self._path, plain)
            _tell_true_size(plain)
            counts = [sum(1 for _ in _whole_rows(*reading, [])) for reading in ((replayed, False), (plain, True))]
            yield from (
                _whole_rows(plain, True, faults) if counts[1] > counts[0] else _whole_rows(replayed, False, faults)
            )


def _begin(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        return file.read(size)


def _parse_head(beginning: bytes) -> _Head:
    page = int.from_bytes(beginning[16:18], "big")
    pages = int.from_bytes(beginning[28:32], "big")
    return _Head(1 << 16 if page == 1 else max(page, 1), pages, beginning[24:28] == beginning[92:96])


def _tell_true_size(path: Path) -> None:
    """Have the head of a database tell as many pages as there are, or SQLite refuses those that it does not know of."""
    with path.open("r+b") as file:
        beginning = file.read(_HEAD)
        if len(beginning) < _HEAD:
            return
        file.seek(28)
        file.write((path.stat().st_size // _parse_head(beginning).page).to_bytes(4, "big"))
        file.seek(92)
        file.write(beginning[24:28])


def _whole_rows(path: Path, until_gap: bool, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield the messages of a database until it turns out to be damaged, without those that do not fit their CRC."""
    with suppress(sqlite3.Error), closing(sqlite3.connect(path)) as database:
        connections = {each.id: each for each in read_connections(database.execute, database)}
        query = f"SELECT id, topic_id, timestamp, data, {_crc_or_null(database)} FROM messages ORDER BY id"
        expected = None
        for number, topic, recorded_ns, message, crc in database.execute(query):
            expected = count(number) if expected is None else expected
            if until_gap and number != next(expected):
                return
            is_message = topic in connections and isinstance(recorded_ns, int) and isinstance(message, bytes)
            if is_message and crc in (None, crc_of(topic, recorded_ns, message)):
                yield connections[topic], recorded_ns, message
            else:
                faults.append(f"message {number} is damaged")


def _crc_or_null(database: sqlite3.Connection) -> str:
    columns = [name for _, name, *_ in database.execute("PRAGMA table_info(messages)")]
    return CRC_COLUMN if CRC_COLUMN in columns else "NULL"


def _damages(database: sqlite3.Connection) -> Iterator[Damage]:
    """Yield the messages that are none, or do not fit their CRC."""
    if _crc_or_null(database) == "NULL" and database.execute(_NO_MESSAGE).fetchone() is None:
        return
    topics = dict(database.execute("SELECT id, name FROM topics"))
    numbers = {topic: count(1) for topic in topics}
    query = f"SELECT topic_id, timestamp, data, {_crc_or_null(database)} FROM messages ORDER BY id"
    for topic, recorded_ns, message, crc in database.execute(query):
        number = next(numbers[topic])
        is_message = isinstance(recorded_ns, int) and isinstance(message, bytes)
        if not is_message or crc not in (None, crc_of(topic, recorded_ns, message)):
            time_ns = recorded_ns if isinstance(recorded_ns, int) else 0
            yield Damage(topics[topic], number, number, time_ns, time_ns)
