"""What any file of a recording is for those who read it: tables of numbers with a time each, whatever the format."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from mmap import ACCESS_READ, mmap
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.message_fields import LONGEST_LISTED
from tam_calibration.messages.samples import Progress, StreamMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.channel_map import ChannelMap, Clock

BATCH = 1 << 16
"""Messages that are joined at once: more leaves the caches, of fewer the patience would hold back a large part."""


@dataclass(frozen=True)
class Table:
    """A topic of a bag, a message of a log, or a text file.

    Parameters
    ----------
    name : str
        Topic, name of the message, or the file's.
    fields : tuple of str
        Paths or columns of its numbers.
    type : str
        Type of a bag's messages; empty of others.
    instance : int
        Which of several of that name in a log.
    count : int, optional
        Number of messages or rows, where that is known.
    is_stamped : bool
        Whether each has a stamp, in addition to the recorder's time.
    units : mapping of str to str
        Units of fields that the format states: ``T``, ``G`` and so on.
    columns : tuple of str
        All columns of a text file, also those that are no numbers; none of topics and messages.
    publishers : int
        How many wrote to a topic, as far as the bag tells them apart.
    frames : tuple of str
        Frames of its first messages, where they state one.
    is_bulky : bool
        Whether its messages are far larger than readings, as those of images and clouds are.
    """

    name: str
    fields: tuple[str, ...]
    type: str = ""
    instance: int = 0
    count: int | None = None
    is_stamped: bool = True
    units: Mapping[str, str] = field(default_factory=dict)
    columns: tuple[str, ...] = ()
    publishers: int = 1
    frames: tuple[str, ...] = ()
    is_bulky: bool = False

    @property
    def is_text(self) -> bool:
        """Whether it has columns: a text file, or a table of a library."""
        return bool(self.columns)

    @property
    def key(self) -> tuple[str, int]:
        """Name and instance."""
        return self.name, self.instance

    @property
    def title(self) -> str:
        """Name for people, with the number of an instance."""
        return f"{self.name} [{self.instance}]" if self.instance else self.name


class Wanted(NamedTuple):
    """Some fields of a table, in the order of the values that are wanted of each message."""

    table: Table
    fields: tuple[str, ...]


Batches = Iterator[dict[str, StreamMessages]]
"""Messages of some streams, many at once."""


def fields_of(wanted: Mapping[str, Wanted]) -> tuple[str, ...]:
    """Return the fields of all streams, one after another."""
    return tuple(field for each in wanted.values() for field in each.fields)


def by_stream(wanted: Mapping[str, Wanted], values: FloatArray) -> dict[str, FloatArray]:
    """Return the values (n, fields) of each stream, of those of all in the order of `fields_of`."""
    ends = np.cumsum([len(each.fields) for each in wanted.values()])
    return dict(zip(wanted, np.split(values, ends[:-1], axis=1), strict=True))


class Source(Protocol):
    """One recording that is open, whatever its format.

    Attributes
    ----------
    path : Path
        Where it lies.
    format : str
        For people.
    unfinished : str
        How a recorder left it, as a clause; empty where it was finished.
    """

    path: Path
    format: str
    unfinished: str

    @property
    def tables(self) -> Sequence[Table]:
        """What it contains."""

    def batches(self, wanted: Mapping[str, Wanted], clock: Clock, progress: Progress) -> Batches:
        """Yield the messages of some streams, many at once, in the order in which they were recorded.

        Parameters
        ----------
        wanted : mapping of str to Wanted
            What is read for each stream.
        clock : {"stamp", "received"}
            Whose time the messages have.
        progress : callable
            Called now and then with the bytes read, and how many there are.
        """


class Reader(Protocol):
    """What opens the files of one format; those of other packages stand under ``tam_calibration.readers``."""

    def recognises(self, path: Path, beginning: bytes) -> bool:
        """Return whether a file, or a folder, is of the format.

        Parameters
        ----------
        path : Path
            It is there.
        beginning : bytes
            The first bytes of a file; none of a folder.
        """

    def open(self, path: Path, channel_map: ChannelMap | None) -> AbstractContextManager[Source]:
        """Open a recording.

        Parameters
        ----------
        path : Path
            The file or folder.
        channel_map : ChannelMap or None
            How it is to be read, where that is stated.
        """


@dataclass(frozen=True, eq=False)
class Columns:
    """A table in memory.

    Parameters
    ----------
    table : Table
        What it is.
    stamps_ns : (n,) array of int
        Its times, nanoseconds.
    values : mapping of str to (n,) array
        Its numbers, by field.
    """

    table: Table
    stamps_ns: IntArray
    values: Mapping[str, FloatArray]

    def rows(self, fields: Sequence[str], index: IntArray) -> FloatArray:
        """Return some fields (n, fields) of some of its messages or rows."""
        return np.column_stack([self.values[each][index] for each in fields])


class MemorySource:
    """A recording in memory: the messages of a log, or several text files.

    Parameters
    ----------
    path : Path
        Where it was read from.
    format : str
        For people.
    columns : sequence of Columns
        Its tables.
    """

    def __init__(self, path: Path, format: str, columns: Sequence[Columns]) -> None:
        self.path, self.format, self.unfinished = path, format, ""
        self.tables: Sequence[Table] = [each.table for each in columns]
        self._columns = {each.table.key: each for each in columns}

    def batches(self, wanted: Mapping[str, Wanted], clock: Clock, progress: Progress) -> Batches:
        """Yield the messages of some streams by their times, as `Source.batches`; there is one clock only."""
        columns = [self._columns[table.key] for table, _ in wanted.values()]
        ends = np.cumsum([len(each.stamps_ns) for each in columns])
        order = np.argsort(np.concatenate([each.stamps_ns for each in columns]), kind="stable")
        for start in range(0, len(order), BATCH):
            some = order[start : start + BATCH]
            batch = {}
            for (name, (_, fields)), each, end in zip(wanted.items(), columns, ends, strict=True):
                begin = end - len(each.stamps_ns)
                places = np.flatnonzero((some >= begin) & (some < end))
                if len(places):
                    index = some[places] - begin
                    batch[name] = StreamMessages(places, each.stamps_ns[index], each.rows(fields, index))
            yield batch
            progress(min(start + BATCH, len(order)), len(order))


log = logging.getLogger(__name__)

PIECE = 1 << 22
"""Bytes of a file that are looked at at once."""


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
    for start in range(0, len(data) - 2, PIECE):
        piece = np.frombuffer(data, np.uint8, min(PIECE + 2, len(data) - start), start)
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
