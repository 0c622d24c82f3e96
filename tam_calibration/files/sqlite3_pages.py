"""Messages read from the pages of a database: of what SQLite holds back until a transaction ends, or cannot reach."""

from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np

from tam_calibration.files.bag_bounds import LARGEST_PIECE
from tam_calibration.model.units import IntArray

_LEAF = 13
"""Kind of a page that holds rows of a table."""

_LEAF_HEAD = 8
_POINTER = 4
_FIRST_BLOB = 12
"""Least type of a value that is bytes; type 12 + 2 n stands for n of them."""

_NULL = 0
_WIDTHS = {_NULL: 0, 1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
"""Bytes of the values of nothing and of whole numbers, by their types; 8 and 9 stand for 0 and 1."""

Row = tuple[int, int, int, bytes, int | None]
"""Number of a message, that of its topic, its time of recording in nanoseconds, its bytes, and its CRC."""


class _Cell(NamedTuple):
    """A row as it lies on a page: its number, and place and size of its content."""

    number: int
    begin: int
    size: int


class DatabasePages:
    """The messages on the pages of a sqlite3 file, whatever leads to these pages.

    Recorders number messages from 1 on, and write the pages of the oldest first.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as file:
            head = file.read(100)
        self._size = page_size(head)
        self._usable = self._size - (head[20] if len(head) > 20 else 0)
        self._pages = path.stat().st_size // self._size
        self._places = self._find()

    def __len__(self) -> int:
        """Return how many messages there are from the first on without one missing."""
        return len(self._places)

    def rows(self) -> Iterator[Row]:
        """Yield the messages by their numbers, from the first on until one is missing or its bytes are."""
        with self._path.open("rb") as file:
            for page, pointer in self._places.tolist():
                content = self._read(file, page)
                row = self._parse(file, content, self._cell(content, pointer))
                if row is None:
                    return
                yield row

    def _find(self) -> IntArray:
        """Return page and pointer (n, 2) of the messages with the numbers 1 to n."""
        found = array("q")
        with self._path.open("rb") as file:
            for page in range(2, self._pages + 1):
                content = self._read(file, page)
                if content[0] != _LEAF:
                    continue
                count = min(int.from_bytes(content[3:5], "big"), (self._size - _LEAF_HEAD) // 2)
                for pointer in range(_LEAF_HEAD, _LEAF_HEAD + 2 * count, 2):
                    cell = self._cell(content, pointer)
                    if cell is not None and _types(content[cell.begin :]) is not None:
                        found.extend((cell.number, page, pointer))
        places = np.array(found, dtype=np.int64).reshape(-1, 3)
        _, first = np.unique(places[:, 0], return_index=True)
        places = places[first]
        until = np.flatnonzero(places[:, 0] != np.arange(1, len(places) + 1))
        return places[: until[0] if len(until) else None, 1:]

    def _read(self, file: BinaryIO, page: int) -> bytes:
        file.seek((page - 1) * self._size)
        return file.read(self._size)

    def _cell(self, content: bytes, pointer: int) -> _Cell | None:
        place = int.from_bytes(content[pointer : pointer + 2], "big")
        if not _LEAF_HEAD <= place < len(content) - 18:  # the longest two numbers
            return None
        size, place = _read_number(content, place)
        number, place = _read_number(content, place)
        return _Cell(number, place, size)

    def _parse(self, file: BinaryIO, content: bytes, cell: _Cell | None) -> Row | None:
        whole = None if cell is None else self._whole(file, content, cell)
        types = None if whole is None else _types(whole)
        if cell is None or whole is None or types is None:
            return None
        place, _ = _read_number(whole, 0)
        parts = []
        for kind in types:
            parts.append(whole[place : place + _width(kind)])
            place += _width(kind)
        if place > len(whole):
            return None
        numbers = [_whole_number(kind, part) for kind, part in zip(types, parts, strict=True)]
        topic, recorded_ns = numbers[1] or 0, numbers[2] or 0
        return cell.number, topic, recorded_ns, parts[3], numbers[4] if len(types) > 4 else None

    def _whole(self, file: BinaryIO, content: bytes, cell: _Cell) -> bytes | None:
        """Return the content of a row, of which a part may lie on pages of its own; None where one is missing."""
        local = self._local(cell.size)
        parts, left = [content[cell.begin : cell.begin + local]], cell.size - local
        following = content[cell.begin + local : cell.begin + local + _POINTER]
        if cell.size > LARGEST_PIECE or len(parts[0]) < local:
            return None
        while left > 0:
            page = int.from_bytes(following, "big")
            if not 2 <= page <= self._pages:
                return None
            content = self._read(file, page)
            if not any(content):
                return None
            parts.append(content[_POINTER : min(self._usable, _POINTER + left)])
            left, following = left - len(parts[-1]), content[:_POINTER]
        return b"".join(parts)

    def _local(self, size: int) -> int:
        """Return how much of a row lies on its own page, by the rule of the format."""
        most = self._usable - 35
        if size <= most:
            return size
        least = (self._usable - 12) * 32 // 255 - 23
        some = least + (size - least) % (self._usable - _POINTER)
        return some if some <= most else least


def page_size(head: bytes) -> int:
    """Return the bytes of a page of a database, by the first bytes of the file."""
    size = int.from_bytes(head[16:18], "big")
    return 1 << 16 if size == 1 else max(size, 512)


def _read_number(content: bytes, place: int) -> tuple[int, int]:
    """Return a number of one to nine bytes, and where it ends."""
    value = 0
    for byte in content[place : place + 8]:
        place += 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, place
    return value << 8 | int.from_bytes(content[place : place + 1], "big"), place + 1


def _types(content: bytes) -> list[int] | None:
    """Return the types of the values of a row of messages; None where it is a row of something else."""
    if not content:
        return None
    end, place = _read_number(content, 0)
    types: list[int] = []
    while place < min(end, len(content)) and len(types) < 6:
        kind, place = _read_number(content, place)
        types.append(kind)
    if len(types) not in (4, 5) or types[0] != _NULL or types[3] < _FIRST_BLOB or types[3] % 2:
        return None
    return types if all(kind in _WIDTHS for kind in (*types[1:3], *types[4:])) else None


def _width(kind: int) -> int:
    return (kind - _FIRST_BLOB) // 2 if kind >= _FIRST_BLOB else _WIDTHS[kind]


def _whole_number(kind: int, part: bytes) -> int | None:
    """Return a whole number; None of nothing."""
    return None if kind == _NULL else kind - 8 if kind in (8, 9) else int.from_bytes(part, "big", signed=True)
