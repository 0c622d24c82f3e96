"""The numbers of a complete recording, table by table, with both clocks and with nothing repaired or left out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.messages.message_fields import stamp_fields, stamps_of
from tam_calibration.messages.samples import Progress, StreamMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.row_source import RowSource, joined_cells
from tam_calibration.recordings.tables import MemorySource, Source, Table, Wanted
from tam_calibration.recordings.vectors import is_bookkeeping

_MOST_NUMBERS = 1 << 26
"""Numbers that are kept: 512 MB. They are those of 1.5 GB of messages; the rest of a larger recording is not read."""


@dataclass(frozen=True, eq=False)
class Series:
    """What was read of a table.

    Parameters
    ----------
    table : Table
        Topic, message of a log, or file.
    fields : tuple of str
        Which of its numbers.
    values : (n, fields) array
        As they stand in the recording.
    stamps_ns : (n,) array of int, optional
        Times that the messages or rows state, nanoseconds.
    received_ns : (n,) array of int, optional
        Times of the recorder.
    time : str
        Where the time comes from, for people.
    remarks : tuple of str
        What was repaired in the time of rows.
    fault : str
        Why it cannot be read, or has no time; empty where it can and has.
    """

    table: Table
    fields: tuple[str, ...]
    values: FloatArray
    stamps_ns: IntArray | None = None
    received_ns: IntArray | None = None
    time: str = ""
    remarks: tuple[str, ...] = ()
    fault: str = ""

    @property
    def are_stamps_zero(self) -> bool:
        """Whether messages have room for a stamp, and none has one."""
        return self.stamps_ns is not None and len(self.stamps_ns) > 0 and not self.stamps_ns.any()

    @property
    def times_ns(self) -> IntArray | None:
        """Times (n,) of the recorder, which all topics share, else the stamps; None without any."""
        return self.stamps_ns if self.received_ns is None else self.received_ns

    def of(self, fields: Sequence[str]) -> FloatArray:
        """Return the values (n, fields) of some fields."""
        return self.values[:, [self.fields.index(field) for field in fields]]


def read_rows(source: RowSource, name: str, progress: Progress) -> Series:
    """Return the rows of a table with their times, as far as these can be read.

    Parameters
    ----------
    source : RowSource
        An open table.
    name : str
        By which a map means it; empty where there is only one.
    progress : callable
        Called now and then with the numbers read.

    Raises
    ------
    InputError
        When a row is no row of numbers.
    """
    table = replace(source.tables[0], name=name)
    parts, count = [], 0
    for part in source.rows(table.fields):
        parts.append(part)
        count += len(part[1])
        progress(count, count)
        if count * max(len(table.fields), 1) > _MOST_NUMBERS:
            break
    if not count:
        raise InputError("it contains no sample")
    rows = np.concatenate([values for _, values in parts])
    try:
        times = source.timed(joined_cells([cells for cells, _ in parts]), count)
    except InputError as problem:
        return Series(table, table.fields, rows, time=_time_of(source), fault=str(problem))
    stamps_ns = times.stamps_ns[times.is_kept]
    if not times.is_kept.all():
        rows = rows[times.is_kept]
    has_time = source.time_column is not None or source.rate_hz is not None
    return Series(table, table.fields, rows, stamps_ns if has_time else None, None, _time_of(source), times.remarks)


def _time_of(source: RowSource) -> str:
    if source.time_column is None:
        return "none"
    return f"column {source.time_column}{f' [{source.time_unit}]' if source.time_unit else ''}"


def read_messages(source: Source, progress: Progress) -> list[Series]:
    """Return the messages of all tables that hold numbers; those of images and clouds are not read.

    Parameters
    ----------
    source : Source
        An open bag or log.
    progress : callable
        Called now and then with what is done, and how much there is to do.

    Raises
    ------
    InputError
        When nothing in it can be read.
    """
    wanted = {str(number): _wanted(table) for number, table in enumerate(source.tables)}
    read = {name: each for name, each in wanted.items() if each.fields}
    alone = [{name: each} for name, each in read.items()]
    problems: list[InputError] = []
    # Tables in memory have no order of messages between them; those of a damaged bag are tried one by one.
    for groups in [alone] if isinstance(source, MemorySource) else [[read], alone]:
        parts, faults = _Parts(), dict[str, str]()
        for group in groups:
            try:
                parts |= _parts(source, group, progress)
            except InputError as problem:
                problems.append(problem)
                faults |= dict.fromkeys(group, str(problem))
        if not faults:
            break
    if problems and not parts:
        raise problems[0]
    return [_series(each, parts.get(name), faults.get(name, "")) for name, each in wanted.items()]


def _wanted(table: Table) -> Wanted:
    if table.is_bulky:
        return Wanted(table, ())
    readings = [field for field in table.fields if not is_bookkeeping(field)]
    return Wanted(table, (*stamp_fields(table.type, table.fields), *readings))


_Parts = dict[str, tuple[IntArray, FloatArray]]
"""For each table its times (n,), nanoseconds, and its values (n, fields)."""


def _parts(source: Source, wanted: Mapping[str, Wanted], progress: Progress) -> _Parts:
    found, count = dict[str, list[StreamMessages]](), 0
    for batch in source.batches(wanted, "received", progress) if wanted else ():
        for name, messages in batch.items():
            found.setdefault(name, []).append(messages)
            count += messages.values.size
        if count > _MOST_NUMBERS:
            break
    parts = {}
    for name, several in found.items():
        times_ns = [each.stamps_ns for each in several if each.stamps_ns is not None]
        # Each field in one piece, as it is looked at by itself.
        parts[name] = np.concatenate(times_ns), np.concatenate([each.values.T for each in several], axis=1).T
    return parts


def _series(wanted: Wanted, parts: tuple[IntArray, FloatArray] | None, fault: str) -> Series:
    table, fields = wanted
    if parts is None:
        return Series(table, (), np.empty((0, 0)), fault=fault)
    times_ns, values = parts
    stamp = len(stamp_fields(table.type, table.fields))
    if stamp:
        stamps_ns = stamps_of(list(values[:, :stamp].T))
        return Series(table, fields[stamp:], values[:, stamp:], stamps_ns, times_ns, "header stamps")
    if table.is_stamped:
        return Series(table, fields, values, times_ns, None, "stamps of the log")
    return Series(table, fields, values, None, times_ns, "the recorder's times")
