"""Logs of autopilots: messages of fixed layouts that lie scattered in a file; their numbers are read when asked for."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.message_fields import LONGEST_LISTED
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.tables import Columns, MemorySource, Table

log = logging.getLogger(__name__)

_PIECE = 1 << 24
"""Bytes that are searched at once."""


class Field(NamedTuple):
    """A number, or a text, in the messages of one layout.

    Parameters
    ----------
    offset : int
        Bytes before it.
    kind : str
        Its type, as numpy names it.
    divisor : float
        Of the number that is stored.
    less : str
        Another field that is taken off; empty of most.
    """

    offset: int
    kind: str
    divisor: float = 1.0
    less: str = ""


Layout = Mapping[str, Field]
"""What the messages of one kind hold, by name."""


@dataclass(frozen=True, eq=False)
class Records(Columns):
    """A table whose messages lie scattered in a file; each is read once for all fields that are wanted of it.

    Parameters
    ----------
    data : mmap
        The log.
    places : (n,) array of int
        Where the contents of the messages begin.
    layout : mapping of str to Field
        What they hold.
    """

    data: mmap
    places: IntArray
    layout: Layout

    def rows(self, fields: Sequence[str], index: IntArray) -> FloatArray:
        """Return some fields (n, fields) of some messages."""
        found = stored(self.data, self.places[index], self.layout)
        with np.errstate(invalid="ignore"):  # bytes of any meaning may be a signalling NaN
            return np.array([self._numbers(found, each) for each in fields]).T

    def _numbers(self, found: NDArray[Any], name: str) -> FloatArray:
        field = self.layout[name]
        numbers = found[name].astype(float) / field.divisor
        return numbers - self._numbers(found, field.less) if field.less else numbers


def stored(data: mmap, places: IntArray, layout: Layout) -> NDArray[Any]:
    """Return messages (n,) of one layout, their fields by name, as they are stored."""
    formats, offsets = [each.kind for each in layout.values()], [each.offset for each in layout.values()]
    kind = np.dtype({"names": list(layout), "formats": formats, "offsets": offsets})
    anywhere: NDArray[Any] = np.ndarray((len(data) - kind.itemsize + 1,), f"V{kind.itemsize}", data, strides=(1,))
    return anywhere[places].view(kind)


def mapped(path: Path) -> mmap:
    """Return the bytes of a file, of which only those that are looked at are read."""
    with path.open("rb") as file:
        return mmap(file.fileno(), 0, access=ACCESS_READ)


def heads_in(data: mmap, mark: bytes) -> IntArray:
    """Return where two bytes stand that messages begin with; also within messages they may."""
    found = []
    for start in range(0, len(data) - 2, _PIECE):
        piece = np.frombuffer(data, np.uint8, min(_PIECE + 2, len(data) - start), start)
        first = np.flatnonzero(piece[:-2] == mark[0])
        found.append(first[piece[first + 1] == mark[1]] + start)
    return np.concatenate(found)


def following(heads: IntArray, ends: IntArray) -> NDArray[np.bool_]:
    """Return which of some places are messages: each but those that lie within the one before.

    Parameters
    ----------
    heads, ends : (n,) array of int
        Where each would begin and end, in rising order of the beginnings.
    """
    is_message = np.ones(len(heads), dtype=bool)
    inside = np.flatnonzero(heads[1:] < ends[:-1])
    for each, after in zip(inside.tolist(), np.searchsorted(heads, ends[inside]).tolist(), strict=True):
        if is_message[each]:
            is_message[each + 1 : after] = False
    return is_message


def records_of(table: Table, data: mmap, places: IntArray, layout: Layout, time: str, tick_ns: int) -> Records:
    """Return the messages of one table; those whose time cannot be are left out.

    Parameters
    ----------
    table : Table
        Its name, instance and units.
    data : mmap
        The log.
    places : (n,) array of int
        Where the contents of its messages begin.
    layout : mapping of str to Field
        What they hold.
    time : str
        The field of the time, of integers.
    tick_ns : int
        Nanoseconds of one of its units.
    """
    ticks = stored(data, places, {time: layout[time]})[time]
    # Later stamps, 146 years after the autopilot was switched on, are damaged.
    is_sound = ticks <= (1 << 62) // tick_ns
    fields = tuple(name for name, field in layout.items() if "S" not in field.kind and name != time)
    is_bulky = len(fields) > LONGEST_LISTED
    described = replace(table, fields=() if is_bulky else fields, count=int(is_sound.sum()), is_bulky=is_bulky)
    return Records(described, ticks[is_sound].astype(np.int64) * tick_ns, {}, data, places[is_sound], layout)


def log_source(path: Path, format: str, columns: Sequence[Columns], lost: int) -> MemorySource:
    """Return a log that was read, and tell of what could not be read.

    Parameters
    ----------
    path : Path
        The file.
    format : str
        For people.
    columns : sequence of Columns
        Its tables.
    lost : int
        Bytes that belong to no complete message.

    Raises
    ------
    InputError
        When it contains nothing.
    """
    if not any(each.table.count for each in columns):
        raise InputError(f"{path} contains no complete message of readings: the log is damaged, or ended at once")
    source = MemorySource(path, format, columns)
    if lost:
        source.unfinished = f"the log was left unfinished or is damaged: {lost} bytes of it are no complete messages"
        log.warning("%s: %s", path, source.unfinished)
    return source
