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

from tam_calibration.messages.cdr import NO_TIME, RawMessages, windows
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray

Definitions = Mapping[str, tuple[Any, Sequence[tuple[str, Any]]]]
"""Constants and fields of each type by its name, fields with their definitions."""

_BASE, _NAME, _ARRAY, _SEQUENCE = 1, 2, 3, 4

_KINDS = [*(f"{sign}int{bits}" for sign in ("", "u") for bits in ("8", "16", "32", "64")), "float32", "float64"]
NUMBERS = dict.fromkeys(("bool", "byte", "char", "octet"), "u1")
NUMBERS |= {name: f"{np.dtype(name).kind}{np.dtype(name).itemsize}" for name in _KINDS}
"""Types of numbers as numpy names them."""

_BYTES = {"byte", "char", "octet", "uint8"}
"""Of these a list is content of another form, as of images and clouds, and no numbers."""


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
    if not nanoseconds:
        return seconds * 1000
    is_time = (seconds >= 0) & (nanoseconds[0] < 1_000_000_000)
    return np.where(is_time, seconds * 1_000_000_000 + nanoseconds[0], NO_TIME)


@dataclass
class _Cursor:
    """Places in some messages: (m,) rows of the result, begin and size of each message, and a place within each.

    The place is one number while it is the same in all messages. If these follow each other at an even step, which is
    not 0 then, numbers are read without an index. Both are much quicker.
    """

    block: NDArray[np.uint8]
    rows: IntArray
    base: IntArray
    size: IntArray
    at: IntArray | int
    order: str
    is_aligned: bool
    step: int = 0

    def align(self, size: int) -> None:
        """Move on to the next place where a number of a size may stand."""
        if self.is_aligned:
            self.at = (self.at + size - 1) & -size

    def read_length(self) -> IntArray:
        """Return the (m,) lengths of strings or lists that begin here, and move on behind them."""
        self.align(4)
        lengths = self.peek("u4")[:, 0].astype(np.int64)
        self.at = self.at + 4
        return lengths

    def peek(self, dtype: str, count: int = 1) -> NDArray[Any]:
        """Return (m, count) numbers that begin here.

        Raises
        ------
        InputError
            When a message ends before.
        """
        size = int(dtype[1:]) * count
        if np.any(self.at + size > self.size):
            raise InputError("a message is damaged: it is shorter than its type says, or of another definition")
        kind = np.dtype(f"{self.order}{dtype}")
        if self.step and isinstance(self.at, int):
            shape, strides = (len(self.rows), count), (self.step, kind.itemsize)
            return np.ndarray(shape, kind, self.block, int(self.base[0]) + self.at, strides)
        found: NDArray[Any] = windows(self.block, size)[self.base + self.at]
        return found.view(kind).reshape(-1, count)

    def of(self, index: IntArray) -> "_Cursor":
        """Return the places of some of the messages."""
        at = self.at if isinstance(self.at, int) else self.at[index]
        return replace(self, rows=self.rows[index], base=self.base[index], size=self.size[index], at=at, step=0)


def _common(places: IntArray | int) -> IntArray | int:
    """Return places as one number, if they are equal."""
    if isinstance(places, int) or not len(places) or (places != places[0]).any():
        return places
    return int(places[0])


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
        self.paths = tuple(self._listed((_NAME, msgtype), ""))
        self._stamp = stamp_fields(msgtype, self.paths)
        self.begins_with_header = not is_ros1 and self.paths[:1] == _STAMPS[0][:1]

    def _listed(self, definition: Any, path: str) -> Iterator[str]:
        """Yield the paths of the numbers below a definition; of lists the path with ``[]``."""
        kind, argument = definition
        if kind == _BASE and argument[0] in NUMBERS:
            yield path
        elif kind == _NAME:
            for name, inner in self._definitions[argument][1]:
                yield from self._listed(inner, f"{path}.{name}" if path else name)
        elif kind == _ARRAY and argument[1] <= LONGEST_LISTED:
            for index in range(argument[1]):
                yield from self._listed(argument[0], f"{path}[{index}]")
        elif kind == _SEQUENCE and argument[0][0] == _BASE and argument[0][1][0] in NUMBERS.keys() - _BYTES:
            yield f"{path}[]"

    def expanded(self, messages: RawMessages) -> tuple[str, ...]:
        """Return the paths with an element each for the lists that have one short length in all of some messages."""
        lengths = self._read(messages, [path for path in self.paths if path.endswith("[]")])
        paths: list[str] = []
        for path in self.paths:
            if path in lengths:
                sizes = np.unique(lengths[path])
                count = int(sizes[0]) if len(sizes) == 1 and sizes[0] <= LONGEST_LISTED else 0
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
        for cursor in self._cursors(messages) if len(messages) and found else ():
            self._walk((_NAME, self._msgtype), "", cursor, _Pending(found))
        return found

    def _cursors(self, messages: RawMessages) -> Iterator[_Cursor]:
        """Yield the beginnings of the messages, those of each byte order."""
        rows, block, start, size = np.arange(len(messages)), messages.block, messages.start, messages.size
        step = int(size[0]) if (size == size[0]).all() else 0
        if step:
            block, start = windows(block, step)[start].view(np.uint8), rows * step
        if self._is_ros1:
            yield _Cursor(block, rows, start, size, 0, "<", False, step)
            return
        kinds = _Cursor(block, rows, start, size, 0, ">", True, step).peek("u2")[:, 0]
        if (kinds > 1).any():
            raise InputError("a message is damaged: it is not in the serialisation CDR")
        body = _Cursor(block, rows, start + 4, size - 4, 0, "<", True, step)
        if (kinds == 1).all():
            yield body
            return
        for order, chosen in zip("><", (kinds == 0, kinds == 1), strict=True):
            yield replace(body.of(np.flatnonzero(chosen)), order=order)

    def _walk(self, definition: Any, path: str, cursor: _Cursor, pending: "_Pending") -> None:
        """Go through what a definition says, and keep the numbers that are wanted."""
        kind, argument = definition
        if kind == _NAME:
            fields = self._definitions[argument][1]
            within = f"{path}." if path else ""
            types = {inner[1][0] if inner[0] == _BASE else "" for _, inner in fields}
            if len(types) == 1 and (number := types.pop()) in NUMBERS:  # a vector, which is read at once
                pending.take([f"{within}{name}" for name, _ in fields], cursor, NUMBERS[number])
                return
            for name, inner in fields:
                if not pending.missing:
                    return
                self._walk(inner, f"{within}{name}", cursor, pending)
        elif kind == _BASE and argument[0] in NUMBERS:
            pending.take([path], cursor, NUMBERS[argument[0]])
        elif kind == _BASE:
            length = cursor.read_length()
            cursor.at = _common(cursor.at + length * (1 if argument[0] == "string" else 4))
        elif kind == _ARRAY:
            self._walk_list(argument[0], path, cursor, pending, np.full(len(cursor.rows), argument[1]))
        else:
            length = cursor.read_length()
            pending.keep(f"{path}[]", cursor.rows, length)
            self._walk_list(argument[0], path, cursor, pending, length)

    def _walk_list(self, element: Any, path: str, cursor: _Cursor, pending: "_Pending", length: IntArray) -> None:
        kind, argument = element
        if kind == _BASE and argument[0] in NUMBERS:
            pending.keep_list(path, cursor, NUMBERS[argument[0]], length)
            return
        # A longer list of structures is a cloud or a map, and no reading of an array.
        if length.max(initial=0) > 4096:
            raise InputError(f"{path} has {length.max()} elements: it is no list that can be read past")
        for index in range(int(length.max(initial=0))):
            chosen = np.flatnonzero(length > index)
            part = cursor.of(chosen)
            self._walk(element, f"{path}[{index}]", part, pending)
            at = np.array(np.broadcast_to(cursor.at, len(cursor.rows)))
            at[chosen] = part.at
            cursor.at = _common(at)


_ELEMENT = re.compile(r"(.*)\[(\d+)\]")


class _Pending:
    """The numbers that are wanted, and the paths of those that have not been met yet."""

    def __init__(self, found: dict[str, FloatArray]) -> None:
        self._found, self.missing = found, set(found)
        self._elements: dict[str, dict[int, str]] = {}
        for path in found:
            if match := _ELEMENT.fullmatch(path):
                self._elements.setdefault(match[1], {})[int(match[2])] = path

    def keep(self, path: str, rows: IntArray, values: NDArray[Any]) -> None:
        """Keep the numbers at a path, where it is wanted."""
        if path in self._found:
            self._found[path][rows] = values
            self.missing.discard(path)

    def take(self, paths: Sequence[str], cursor: _Cursor, dtype: str) -> None:
        """Keep the wanted ones of numbers of one type that follow each other, and move on behind them."""
        size = int(dtype[1:])
        cursor.align(size)
        if any(path in self._found for path in paths):
            for path, values in zip(paths, cursor.peek(dtype, len(paths)).T, strict=True):
                self.keep(path, cursor.rows, values)
        cursor.at = cursor.at + size * len(paths)

    def keep_list(self, path: str, cursor: _Cursor, dtype: str, length: IntArray) -> None:
        """Keep those elements of lists of some lengths (m,) that are wanted, and move on behind the lists."""
        size, before = int(dtype[1:]), cursor.at
        cursor.align(size)
        for index, element in self._elements.get(path, {}).items():
            is_there = length > index
            own = replace(cursor) if is_there.all() else cursor.of(np.flatnonzero(is_there))
            own.at = own.at + size * index
            self.keep(element, own.rows, own.peek(dtype)[:, 0])
        cursor.at = _common(np.where(length > 0, cursor.at + size * length, before))
