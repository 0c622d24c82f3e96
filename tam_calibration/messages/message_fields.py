"""Numbers inside serialised messages of any type, read from many messages at once.

A definition is what rosbags parses: ``(kind, argument)``, with the kinds BASE, NAME, ARRAY and SEQUENCE. Messages of
ROS 2 are plain CDR (XCDR1 of the OMG's DDS-XTypes 1.3, 7.4.1: each number aligned to its size); those of ROS 1 follow
without gaps.
"""

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.cdr import RawMessages, windows
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray

Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, Any]]]]
"""Constants and fields of each type by its name, fields with their definitions."""

_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4

_NUMBERS = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "octet": "u1",
    **{f"{sign}int{bits}": f"{sign[:1] or 'i'}{bits // 8}" for sign in ("", "u") for bits in (8, 16, 32, 64)},
    "float32": "f4",
    "float64": "f8",
}
"""Types of numbers as numpy names them."""

_BYTES = {"byte", "char", "octet", "uint8"}
"""Of these a list is content of another form, as of images and clouds, and no numbers."""

_MOST_ELEMENTS = 4096
"""Of a list of structures in a message: what is longer is a cloud or map, and no reading of an array of sensors."""

LONGEST_LISTED = 256
"""Elements of an array whose places are listed: 64 sensors have 192 numbers."""

_STAMPS = (("header.stamp.sec", "header.stamp.nanosec"), ("stamp.sec", "stamp.nanosec"))
"""Where a message has its stamp, the first that it has."""

_MICROSECONDS = "timestamp"
"""Field of messages of PX4, in microseconds."""


def stamp_fields(msgtype: str, fields: Collection[str]) -> tuple[str, ...]:
    """Return the fields of a message's stamp: seconds and nanoseconds, or microseconds; empty where it has none.

    Parameters
    ----------
    msgtype : str
        Type of the message.
    fields : collection of str
        Paths of its numbers.
    """
    names = set(fields)
    is_px4 = msgtype.startswith("px4_msgs/") and _MICROSECONDS in names
    return next((pair for pair in _STAMPS if set(pair) <= names), (_MICROSECONDS,) if is_px4 else ())


def stamps_of(parts: Sequence[FloatArray]) -> IntArray:
    """Return stamps (n,), nanoseconds, from the values (n,) of each of their fields."""
    seconds, *nanoseconds = (part.astype(np.int64) for part in parts)
    return seconds * 1_000_000_000 + nanoseconds[0] if nanoseconds else seconds * 1000


@dataclass
class _Cursor:
    """Places in some messages: (m,) rows of the result, and the place of each in the block."""

    block: NDArray[np.uint8]
    rows: IntArray
    base: IntArray
    end: IntArray
    at: IntArray
    order: str
    is_aligned: bool

    def align(self, size: int) -> None:
        """Move on to the next place where a number of a size may stand."""
        if self.is_aligned:
            self.at = self.base + ((self.at - self.base + size - 1) & -size)

    def skip(self, size: IntArray | int) -> None:
        """Move on by some bytes."""
        self.at = self.at + size

    def read(self, dtype: str, count: int = 1) -> NDArray[Any]:
        """Return (m, count) numbers, and move on behind them."""
        size = int(dtype[1:])
        self.align(size)
        values = self.peek(dtype, count)
        self.skip(size * count)
        return values

    def peek(self, dtype: str, count: int = 1) -> NDArray[Any]:
        """Return (m, count) numbers from here on.

        Raises
        ------
        InputError
            When a message ends before.
        """
        size = int(dtype[1:]) * count
        if (self.at < self.base).any() or (self.at + size > self.end).any():
            raise InputError("a message is shorter than its type says: it is damaged, or of another definition")
        taken: NDArray[Any] = windows(self.block, size)[self.at].view(f"{self.order}{dtype}").reshape(-1, count)
        return taken

    def of(self, index: IntArray) -> "_Cursor":
        """Return the places of some of the messages."""
        chosen = {name: getattr(self, name)[index] for name in ("rows", "base", "end", "at")}
        return replace(self, **chosen)


class MessageFields:
    """The numbers of the messages of one type.

    Parameters
    ----------
    definitions : mapping
        Of the type and of all that it is made of.
    msgtype : str
        Its name, such as ``sensor_msgs/msg/Imu``.
    is_ros1 : bool
        Whether messages are serialised as in ROS 1.
    """

    def __init__(self, definitions: Definitions, msgtype: str, is_ros1: bool = False) -> None:
        self._definitions, self._msgtype, self._is_ros1 = definitions, msgtype, is_ros1
        self.has_sequences = False
        self.paths = tuple(self._listed((_NAME, msgtype), ""))
        self._stamp = stamp_fields(msgtype, self.paths)
        self.begins_with_header = not is_ros1 and self.paths[:1] == _STAMPS[0][:1]

    def _listed(self, definition: Any, path: str) -> Iterator[str]:
        """Yield the paths of the numbers below a definition; of lists the path with ``[]``."""
        kind, argument = definition
        if kind == _BASE and argument[0] in _NUMBERS:
            yield path
        elif kind == _NAME:
            for name, inner in self._definitions[argument][1]:
                yield from self._listed(inner, f"{path}.{name}" if path else name)
        elif kind == _ARRAY and argument[1] <= LONGEST_LISTED:
            for index in range(argument[1]):
                yield from self._listed(argument[0], f"{path}[{index}]")
        elif kind == _SEQUENCE and argument[0][0] == _BASE and argument[0][1][0] in _NUMBERS.keys() - _BYTES:
            self.has_sequences = True
            yield f"{path}[]"

    def expanded(self, messages: RawMessages) -> tuple[str, ...]:
        """Return the paths with an element each for the lists that have one short length in all of some messages."""
        lengths = self._read(messages, [path for path in self.paths if path.endswith("[]")])
        paths: list[str] = []
        for path in self.paths:
            if path in lengths:
                length = lengths[path]
                count = int(length[0]) if len(length) and (length == length[0]).all() else 0
                count = count if count <= LONGEST_LISTED else 0
                paths += [f"{path[:-1]}{index}]" for index in range(count)]
            else:
                paths.append(path)
        return tuple(paths)

    def read(self, messages: RawMessages, paths: Sequence[str]) -> tuple[IntArray | None, FloatArray]:
        """Return the (n,) stamps, nanoseconds, None where there are none, and the (n, paths) numbers at some paths.

        Parameters
        ----------
        messages : RawMessages
            Of this type.
        paths : sequence of str
            As ``data[3]`` or ``mag.x``; NaN where a list is shorter.

        Raises
        ------
        InputError
            When a message is damaged, or is no plain CDR.
        """
        found = self._read(messages, [*paths, *self._stamp])
        values = np.column_stack([found[path] for path in paths]) if paths else np.zeros((len(messages), 0))
        return stamps_of([found[part] for part in self._stamp]) if self._stamp else None, values

    def _read(self, messages: RawMessages, paths: Sequence[str]) -> dict[str, FloatArray]:
        found = {path: np.full(len(messages), np.nan) for path in paths}
        if len(messages) and found:
            self._walk((_NAME, self._msgtype), "", self._cursor(messages), _Pending(found))
        return found

    def _cursor(self, messages: RawMessages) -> _Cursor:
        end, rows = messages.start + messages.size, np.arange(len(messages))
        if self._is_ros1:
            return _Cursor(messages.block, rows, messages.start, end, messages.start, "<", False)
        begin = _Cursor(messages.block, rows, messages.start, end, messages.start, "<", True)
        kinds = begin.peek("u1", 2)
        if (kinds[:, 0] != 0).any() or (kinds[:, 1] > 1).any() or (kinds[:, 1] != kinds[0, 1]).any():
            raise InputError("the messages are no plain CDR, or of several byte orders")
        base = messages.start + 4
        return _Cursor(messages.block, rows, base, end, base, "<" if kinds[0, 1] else ">", True)

    def _walk(self, definition: Any, path: str, cursor: _Cursor, pending: "_Pending") -> None:
        """Go through what a definition says, and keep the numbers that are wanted."""
        kind, argument = definition
        if kind == _NAME:
            for name, inner in self._definitions[argument][1]:
                if pending.is_done:
                    return
                self._walk(inner, f"{path}.{name}" if path else name, cursor, pending)
        elif kind == _BASE:
            self._walk_base(argument[0], path, cursor, pending)
        elif kind == _ARRAY and argument[0][0] == _BASE and argument[0][1][0] in _NUMBERS:
            pending.keep_list(path, cursor, _NUMBERS[argument[0][1][0]], np.full(len(cursor.rows), argument[1]))
        elif kind == _ARRAY:
            for index in range(argument[1]):
                self._walk(argument[0], f"{path}[{index}]", cursor, pending)
        else:
            self._walk_sequence(argument[0], path, cursor, pending)

    def _walk_base(self, name: str, path: str, cursor: _Cursor, pending: "_Pending") -> None:
        if name in _NUMBERS:
            values = cursor.read(_NUMBERS[name])
            pending.keep(path, cursor.rows, values[:, 0])
        else:
            length = cursor.read("u4")[:, 0].astype(np.int64)
            cursor.skip(length if name == "string" else 4 * length)

    def _walk_sequence(self, element: Any, path: str, cursor: _Cursor, pending: "_Pending") -> None:
        length = cursor.read("u4")[:, 0].astype(np.int64)
        pending.keep(f"{path}[]", cursor.rows, length)
        kind, argument = element
        if kind == _BASE and argument[0] in _NUMBERS:
            pending.keep_list(path, cursor, _NUMBERS[argument[0]], length)
            return
        if length.max(initial=0) > _MOST_ELEMENTS:
            raise InputError(f"{path} has {length.max()} elements: it is no list that can be read past")
        for index in range(int(length.max(initial=0))):
            chosen = np.flatnonzero(length > index)
            part = cursor.of(chosen)
            self._walk(element, f"{path}[{index}]", part, pending)
            at = cursor.at.copy()
            at[chosen] = part.at
            cursor.at = at


_ELEMENT = re.compile(r"(.*)\[(\d+)\]")


class _Pending:
    """The numbers that are wanted, and how many have not been met yet."""

    def __init__(self, found: dict[str, FloatArray]) -> None:
        self._found, self._missing = found, set(found)
        self._elements: dict[str, dict[int, str]] = {}
        for path in found:
            if match := _ELEMENT.fullmatch(path):
                self._elements.setdefault(match[1], {})[int(match[2])] = path

    @property
    def is_done(self) -> bool:
        """Whether all have been met."""
        return not self._missing

    def keep(self, path: str, rows: IntArray, values: NDArray[Any]) -> None:
        """Keep the numbers at a path, where it is wanted."""
        if path in self._found:
            self._found[path][rows] = values
            self._missing.discard(path)

    def keep_list(self, path: str, cursor: _Cursor, dtype: str, length: IntArray) -> None:
        """Keep those elements of lists of some lengths (m,) that are wanted, and move on behind the lists."""
        size, before = int(dtype[1:]), cursor.at
        cursor.align(size)
        for index, element in self._elements.get(path, {}).items():
            chosen = np.flatnonzero(length > index)
            own = replace(cursor.of(chosen), at=cursor.at[chosen] + size * index)
            self.keep(element, own.rows, own.peek(dtype)[:, 0])
            self._missing.discard(element)
        cursor.at = np.where(length > 0, cursor.at + size * length, before)
