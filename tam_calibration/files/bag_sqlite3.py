"""Messages of sqlite3 files, many rows by one query."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

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


def read_rows(storage: Sqlite3Reader, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of some topics, in the order of recording, and the bytes read for them.

    The database itself joins rows, which spares an object for each.

    Parameters
    ----------
    storage : Sqlite3Reader
        An open file.
    position : mapping
        For each topic that is read the number that stands for it.
    """
    gather = _GATHER.format(",".join(map(str, position)))
    number = np.zeros(max(position) + 1, dtype=np.int64)
    number[list(position)] = list(position.values())
    size = Path(str(storage.path)).stat().st_size
    first, last, count = _fetch(storage, _SPAN)
    rows = max(min(ROWS, BYTES * count // size), 1) if count else 0
    while count and first <= last:
        following = _fetch(storage, _NEXT, first, rows)
        end = max(following[0], first + 1) if following else last + 1
        topics, times, sizes, block = _fetch(storage, gather, first, end)
        first = end
        if block is not None:
            yield _messages(number[_parse(topics)], _parse(times), _parse(sizes), block), size * rows // count


def _fetch(storage: Sqlite3Reader, query: str, *values: int) -> Any:
    assert storage.dbconn is not None
    return next(iter(storage.dbconn.execute(query, values)), None)


def _parse(numbers: str) -> IntArray:
    return np.fromstring(numbers, dtype=np.int64, sep=",")


def _messages(connection: IntArray, recorded_ns: IntArray, size: IntArray, block: bytes) -> RawMessages:
    if int(size.sum()) != len(block):
        raise InputError("the sizes of its messages are not those of their bytes")
    return RawMessages(connection, recorded_ns, np.cumsum(size) - size, size, np.frombuffer(block, np.uint8))
