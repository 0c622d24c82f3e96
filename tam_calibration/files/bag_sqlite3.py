"""Messages of sqlite3 files, many rows by one query."""

import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import closing
from pathlib import Path

import numpy as np

from tam_calibration.files.raw_messages import IntArray, RawMessages
from tam_calibration.problems import InputError

ROWS, BYTES = 16_384, 8_000_000
"""How much a query gathers, at most rows, and bytes of messages of mean size."""

_SPAN = "SELECT min(timestamp), max(timestamp), count(*) FROM messages"
_NEXT = "SELECT timestamp FROM messages WHERE timestamp >= ? ORDER BY timestamp LIMIT 1 OFFSET ?"
_GATHER = """
SELECT group_concat(topic_id), group_concat(timestamp), group_concat(length(data)), CAST(group_concat(data, '') AS BLOB)
FROM (SELECT * FROM messages WHERE timestamp >= ? AND timestamp < ? AND topic_id IN ({}) ORDER BY timestamp, id)
"""


def read_rows(path: Path, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of some topics, in the order of recording, and the bytes read for them.

    The database itself joins rows, which spares an object for each.

    Parameters
    ----------
    path : Path
        The file.
    position : mapping
        For each topic that is read the number that stands for it.
    """
    gather = _GATHER.format(",".join(map(str, position)))
    number = np.zeros(max(position) + 1, dtype=np.int64)
    number[list(position)] = list(position.values())
    with closing(sqlite3.connect(f"{path.resolve().as_uri()}?immutable=1", uri=True)) as database:
        first, last, count = database.execute(_SPAN).fetchone()
        size = path.stat().st_size
        rows = max(min(ROWS, BYTES * count // size), 1) if count else 0
        while count and first <= last:
            row = database.execute(_NEXT, (first, rows)).fetchone()
            end = max(row[0], first + 1) if row else last + 1
            topics, times, sizes, block = database.execute(gather, (first, end)).fetchone()
            first = end
            if block is not None:
                yield _messages(number[_parse(topics)], _parse(times), _parse(sizes), block), size * rows // count


def _parse(numbers: str) -> IntArray:
    return np.fromstring(numbers, dtype=np.int64, sep=",")


def _messages(connection: IntArray, recorded_ns: IntArray, size: IntArray, block: bytes) -> RawMessages:
    if int(size.sum()) != len(block):
        raise InputError("the sizes of its messages are not those of their bytes")
    return RawMessages(connection, recorded_ns, np.cumsum(size) - size, size, np.frombuffer(block, np.uint8))
