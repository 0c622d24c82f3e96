"""The numbers of a complete recording, table by table, nothing repaired or left out, and what is odd about them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.message_fields import stamp_fields, stamps_of
from tam_calibration.messages.missing import FAR, NAN, REASONS, Range, are, codes_of
from tam_calibration.messages.samples import Progress, StreamMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import FEWEST_SAMPLES, SKETCH
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.intake import Counter
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


def of_times(series: Series) -> list[str]:
    """Return what is odd about the times of a table.

    Parameters
    ----------
    series : Series
        What was read of it.
    """
    remarks = list(series.remarks)
    if series.fault:
        remarks.append(series.fault)
    if series.table.publishers > 1:
        remarks.append(f"{series.table.publishers} publishers wrote to it")
    if len(series.table.frames) > 1:
        remarks.append(f"messages are of several frames, {', '.join(series.table.frames[:4])}: two publishers?")
    stamps_ns, received_ns, times_ns = series.stamps_ns, series.received_ns, series.times_ns
    if times_ns is None or len(times_ns) < 2 * FEWEST_SAMPLES:
        return remarks
    if series.are_stamps_zero:
        remarks.append("all stamps are zero: the recorder's times are used")
    if series.are_stamps_zero or stamps_ns is None:
        return remarks + _pauses(times_ns, None, times_ns)
    if received_ns is None:
        return remarks + _order(stamps_ns, stamps_ns) + _pauses(stamps_ns, None, stamps_ns)
    has_stamp = stamps_ns > 0
    if not has_stamp[1:].all():
        remarks.append(f"{_of(~has_stamp)} stamps are zero")
    stamps_ns, received_ns = stamps_ns[has_stamp], received_ns[has_stamp]
    remarks += _order(stamps_ns, received_ns) + _pauses(stamps_ns, received_ns, received_ns)
    return remarks + _clocks(stamps_ns, received_ns)


def _of(is_odd: NDArray[np.bool_]) -> str:
    return f"{int(is_odd.sum())} of {len(is_odd)}"


def _at(index: int, times_ns: IntArray) -> str:
    return f"at {(times_ns[index] - times_ns[0]) / 1e9:.2f} s"


def _order(stamps_ns: IntArray, since_ns: IntArray) -> list[str]:
    """Return how often stamps repeat or go back."""
    remarks, steps = [], np.diff(stamps_ns)
    if (steps == 0).any():
        remarks.append(
            f"{_of(steps == 0)} stamps repeat the one before, first {_at(int(np.argmax(steps == 0)), since_ns)}"
        )
    if (back := steps < 0).any():
        # A clock that was set steps back less often.
        why = ": two publishers on one topic, or readings out of order?" if back.mean() > 0.1 else ""
        most, first = -float(steps.min()) / 1e9, _at(int(np.argmax(back)), since_ns)
        remarks.append(f"stamps go back {int(back.sum())} times, by up to {most:.3g} s, first {first}{why}")
    return remarks


def _pauses(stamps_ns: IntArray, received_ns: IntArray | None, since_ns: IntArray) -> list[str]:
    """Return the gaps, and the jumps of stamps where the recorder saw no gap."""
    steps = np.diff(stamps_ns)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    # One or two lost messages are no gap.
    is_long = steps > 5.0 * usual
    if not usual or not is_long.any():
        return []
    is_jump = np.zeros_like(is_long) if received_ns is None else is_long & (np.diff(received_ns) < 0.5 * steps)
    remarks = []
    for kind, chosen in (("gaps", is_long & ~is_jump), ("jumps of the stamps without a gap", is_jump)):
        if chosen.any():
            longest = int(np.argmax(np.where(chosen, steps, 0)))
            remarks.append(
                f"{int(chosen.sum())} {kind}, the longest {steps[longest] / 1e9:.3g} s {_at(longest, since_ns)}"
            )
    return remarks


def _clocks(stamps_ns: IntArray, received_ns: IntArray) -> list[str]:
    """Return how the clock of the stamps differs from the recorder's."""
    late_s = (received_ns - stamps_ns) / 1e9
    least = [float(part.min()) for part in np.array_split(late_s, 10)]
    span_s = float(received_ns[-1] - received_ns[0]) / 1e9
    remarks, median = [], float(np.median(late_s))
    # No driver delivers readings so late.
    if abs(median) > 2.0:
        remarks.append(
            f"the clock of the stamps is {abs(median):.6g} s {'behind' if median > 0 else 'ahead of'} the recorder's"
        )
    drift = least[-1] - least[0]
    # Drivers, and quartz clocks that are set by a network, drift less.
    if span_s and abs(drift) > 0.01 and abs(drift) / span_s > 20e-6 and np.ptp(least) < 2 * abs(drift):
        remarks.append(f"the clock of the stamps drifts by {1e6 * drift / span_s:+.3g} ppm ({drift:+.3g} s)")
    return remarks


def thinned(values: FloatArray) -> FloatArray:
    """Return some of the readings (n, width), evenly spread: enough for their size and their range."""
    return values[:: len(values) // SKETCH + 1]


def missing_of(values: FloatArray, is_field: bool) -> tuple[NDArray[np.int8], dict[str, int]]:
    """Return the code of each missing reading (n,), 0 of the others, and how many are missing for each reason.

    Parameters
    ----------
    values : (n, width) array
        As they were recorded.
    is_field : bool
        Whether they read a magnetic field. Others are missing only where they are NaN.
    """
    codes = np.zeros(len(values), dtype=np.int8)
    if is_field:
        stream = "scalar" if values.shape[1] == 1 else "tam_1"
        codes = codes_of(stream, values)
    codes[np.isnan(values).any(axis=1) & (codes == 0)] = NAN
    if is_field and (codes == 0).any():
        some = thinned(values if not codes.any() else values[codes == 0])
        codes[Range.of(stream, some).beyond(values) & (codes == 0)] = FAR
    return codes, {REASONS[code]: int((codes == code).sum()) for code in np.unique(codes[codes > 0]).tolist()}


def of_readings(values: FloatArray, is_field: bool, codes: NDArray[np.int8], times_ns: IntArray | None) -> list[str]:
    """Return what is odd about the readings of a channel.

    Parameters
    ----------
    values : (n, width) array
        As they were recorded.
    is_field : bool
        Whether they read a magnetic field.
    codes : (n,) array
        Of the missing ones.
    times_ns : (n,) array of int, optional
        Their times.
    """
    remarks = []
    for code in np.unique(codes[codes > 0]).tolist():
        is_odd = codes == code
        first = "" if times_ns is None else f", first {_at(int(np.argmax(is_odd)), times_ns)}"
        remarks.append(f"{_of(is_odd)} readings {are(code, int(is_odd.sum()))}{first}")
    there = values[codes == 0] if codes.any() else values
    if len(there) < 2 * FEWEST_SAMPLES:
        return remarks
    if (there == there[0]).all():
        return [*remarks, "readings never change"]
    return remarks + _of_vectors(there) if is_field and values.shape[1] == 3 else remarks


def _of_vectors(values: FloatArray) -> list[str]:
    remarks = Counter.of(values).overflows(values)
    values = values[:SKETCH]
    steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
    # By chance fewer readings repeat.
    if (held := float((steps == 0).mean())) > 0.2:
        remarks.append(
            f"{100 * held:.0f} % of the readings repeat the one before: the sensor is slower than its messages"
        )
    # With one sensor, however noisy, the ratio is 1 at most.
    elif not remarks and np.median(steps) > 3.0 * np.median(np.linalg.norm(values[2:] - values[:-2], axis=1)):
        remarks.append("readings alternate between two values: two publishers on one topic?")
    return remarks


def without_overlap(named: Sequence[tuple[str, IntArray]]) -> str:
    """Return which two streams have stamps at other times, so that none can be joined; empty where all overlap.

    Parameters
    ----------
    named : sequence of (str, (n,) array of int)
        Name and stamps of each.
    """
    last = min(named, key=lambda each: int(each[1].max()))
    first = max(named, key=lambda each: int(each[1].min()))
    apart = int(first[1].min()) - int(last[1].max())
    if apart <= 0:
        return ""
    return f"the stamps of {first[0]} begin {apart / 1e9:.6g} s after those of {last[0]} end: they have no common clock"
