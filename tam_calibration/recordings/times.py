"""The times of rows: read in whatever form they are written, and repaired where counters wrap or digits are too few."""

import re
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.timeline import LONGEST_PERIOD_NS
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.recording import SKETCH
from tam_calibration.model.units import FloatArray, IntArray

PER_SECOND = {"s": 1, "ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}
"""Ticks of a second in each format of numbers."""

_NAMES = re.compile(
    r"(time|date|datetime|timestamp|time_?stamp|stamp|(?-i:t)|utc|epoch|gps_?time|sec|secs|seconds|millis|micros|ticks?)"
    r"([ _\[(.]*(?P<unit>s|secs?|seconds|ms|msec|millis|milliseconds|[uµ]s|usec|micros|microseconds|ns|nsec|nanoseconds"
    r"|utc|iso|local)[\])]?)?",
    re.I,
)
"""Names of columns of time, with their unit."""

_CLOCK = re.compile(r"\d\d:\d\d:\d\d(\.\d+)?")
"""A time of day without its date."""

_UNITS = {"m": "ms", "u": "us", "µ": "us", "n": "ns", "s": "s"}
_WORDS = {"millis": "ms", "milliseconds": "ms", "micros": "us", "microseconds": "us", "nanoseconds": "ns"}


@dataclass(frozen=True, eq=False)
class Times:
    """Times of rows.

    Parameters
    ----------
    stamps_ns : (n,) array of int
        Rising, nanoseconds.
    is_kept : (n,) array of bool
        Rows that are not repeated.
    remarks : tuple of str
        What was repaired, a clause each.
    """

    stamps_ns: IntArray
    is_kept: NDArray[np.bool_]
    remarks: tuple[str, ...] = ()

    def of(self, rows: slice) -> "Times":
        """Return the times of some of the rows."""
        return Times(self.stamps_ns[rows], self.is_kept[rows], self.remarks)


def time_unit(name: str) -> str | None:
    """Return the unit that the name of a column of time states, empty where it states none; None of other columns."""
    match = _NAMES.fullmatch(name.strip())
    if match is None:
        return None
    if match[1].lower() in _WORDS:
        return _WORDS[match[1].lower()]
    unit = (match["unit"] or "").lower()
    return _WORDS.get(unit, _UNITS.get(unit[:1], "") if unit not in ("utc", "iso", "local") else "")


def stamps_of_numbers(values: FloatArray, unit: str) -> tuple[IntArray, str]:
    """Return times as nanoseconds, and their unit, which is detected where it is no name in ``PER_SECOND``.

    Parameters
    ----------
    values : (n,) array
        As they stand in the file.
    unit : str
        As stated; empty where it is not.

    Raises
    ------
    InputError
        When one is no time.
    """
    is_none = ~np.isfinite(values)
    if is_none.any():
        raise InputError(
            f"the time of row {int(is_none.argmax()) + 1} is {values[is_none][0]:g}: {int(is_none.sum())} of "
            f"{len(values)} rows have no time; leave them out"
        )
    unit = unit if unit in PER_SECOND else detect_time_unit(values)
    per_second = PER_SECOND[unit]
    largest = max(float(values.max()), -float(values.min()))
    if largest / per_second >= 9.2e9:
        raise InputError(f"a time is {largest:.3g} {unit}, beyond the year 2262: check its unit")
    ticks, parts = 1_000_000_000 // per_second, []
    for part in np.array_split(values, 1 + len(values) // SKETCH):  # the times of millions of rows take much memory
        integers = np.floor(part)
        parts.append(integers.astype(np.int64) * ticks + np.rint((part - integers) * ticks).astype(np.int64))
    return np.concatenate(parts), unit


def detect_time_unit(values: FloatArray) -> str:
    """Return the unit in which times are those of day, or their steps those of samples."""
    largest = float(np.abs(values).max())
    steps = np.diff(values)
    rising = steps[steps > 0]
    step = float(np.median(rising)) if len(rising) else 0.0
    slowest_s = LONGEST_PERIOD_NS / PER_SECOND["ns"]
    for unit, per_second in PER_SECOND.items():
        # Seconds since 1970 of the years 1979 to 2096; larger numbers have a shorter tick.
        low, high = (limit * per_second for limit in (3e8, 4e9))
        if low <= largest <= high and step <= slowest_s * per_second:
            return unit
    is_complete = bool((values == np.round(values)).all())
    for unit, per_second in PER_SECOND.items():
        if step / per_second <= (slowest_s if not is_complete or unit != "s" else 1.0):
            return unit
    return "s"


def stamps_of_words(words: Sequence[str], form: str) -> IntArray:
    """Return the times of day that words state, nanoseconds since 1970; those without a zone are UTC.

    Without a date they count from midnight, and go on past the next.

    Parameters
    ----------
    words : sequence of str
        Cells of the column.
    form : str
        ``iso8601``, a pattern of ``strptime``, or empty for the first.

    Raises
    ------
    InputError
        When one is no such time.
    """
    is_iso = form in ("", "iso8601")
    plain = np.asarray([word.strip().replace(",", ".") for word in words]) if is_iso else np.asarray(words)
    if is_iso and len(plain) and all(map(_CLOCK.fullmatch, plain.tolist())):
        of_day = stamps_of_words([f"1970-01-01T{word}" for word in plain.tolist()], form)
        return np.unwrap(of_day, period=24 * 3600 * PER_SECOND["ns"]).astype(np.int64)
    if is_iso:
        with catch_warnings(), suppress(ValueError, UserWarning, DeprecationWarning):
            simplefilter("error")  # numpy warns of zones, which it does not read
            moments = np.char.rstrip(plain, "Zz").astype("datetime64[ns]")
            if not np.isnat(moments).any():
                return np.asarray(moments.astype(np.int64))
    stamps = []
    for number, word in enumerate(plain.tolist(), 1):
        try:
            moment = datetime.fromisoformat(word) if is_iso else datetime.strptime(word, form)
        except ValueError:
            expected = "an ISO 8601 time" if is_iso else f"a time of the format {form}"
            raise InputError(f"the time of row {number}, {quoted(word)}, is not {expected}") from None
        stamps.append(nanoseconds_of(moment))
    return np.array(stamps, dtype=np.int64)


def nanoseconds_of(moment: datetime) -> int:
    """Return a moment in nanoseconds since 1970; one without a zone is UTC."""
    since = (moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - datetime(1970, 1, 1, tzinfo=UTC)
    return since // timedelta(microseconds=1) * 1000


def repaired(stamps_ns: IntArray, unit: str) -> Times:
    """Return times that rise: counters that wrap go on, and times with too few digits are spread evenly.

    Parameters
    ----------
    stamps_ns : (n,) array of int
        As they were read.
    unit : str
        Of the counter that they may be, a name in ``PER_SECOND``; empty for times of day.

    Raises
    ------
    InputError
        When time goes backwards otherwise.
    """
    remarks: list[str] = []
    steps = np.diff(stamps_ns)
    if unit and (steps < 0).any():
        stamps_ns, steps, remark = _unwrapped(stamps_ns, steps, unit)
        remarks += [remark] if remark else []
    if (steps < 0).any():
        first = int(np.argmax(steps < 0))
        seconds = (stamps_ns[[first, first + 1]] - stamps_ns[0]) / 1e9
        raise InputError(
            f"time goes backwards at sample {first + 2}: after {seconds[0]:.6f} s comes {seconds[1]:.6f} s "
            f"({int((steps < 0).sum())} such places), counted from the first sample. Split the file there, or "
            "state time: {rate_hz: …} in a map if the rows follow each other evenly"
        )
    is_kept = np.ones(len(stamps_ns), dtype=bool)
    repeats = steps == 0
    # A few repeated times are rows that came twice; many have too few digits.
    if repeats.mean() > 0.1 if len(steps) else False:
        stamps_ns, per_stamp = _spread(stamps_ns)
        remarks.append(
            f"the times have too few digits: {per_stamp:.3g} samples share each, and were spread evenly, so that rates "
            "and delays are not known well"
        )
    elif repeats.any():
        is_kept[1:] = ~repeats
        remarks.append(f"{int(repeats.sum())} rows repeat the time before them and were left out")
    return Times(stamps_ns, is_kept, tuple(remarks))


def _unwrapped(stamps_ns: IntArray, steps: IntArray, unit: str) -> tuple[IntArray, IntArray, str]:
    """Return times whose counter goes on where it wraps, their steps, and a clause that says so."""
    tick = 1_000_000_000 // PER_SECOND[unit]
    typical = int(np.median(steps[steps > 0])) if (steps > 0).any() else 0
    for bits in (16, 24, 32):
        size = tick << bits
        # A counter that wraps falls by more than half its range.
        falls = steps < -0.5 * size
        is_next = steps[falls] + size < 1000 * max(typical, tick)
        if falls.sum() == (steps < 0).sum() and (stamps_ns < size).all() and is_next.all():
            turned = stamps_ns + size * np.concatenate([[0], np.cumsum(falls)])
            return turned, np.diff(turned), f"its counter of {bits} bits wrapped {int(falls.sum())} times, and goes on"
    return stamps_ns, steps, ""


def _spread(stamps_ns: IntArray) -> tuple[IntArray, float]:
    """Return times that share a value spread evenly until the next value, and how many shared one."""
    values, first, counts = np.unique(stamps_ns, return_index=True, return_counts=True)
    if len(values) < 2:
        raise InputError("all rows have one time: state time: {rate_hz: …} in a map")
    usual = int(np.median(np.diff(values)))
    following = np.append(values[1:], values[-1] + usual)
    # A gap between two values is no reason to stretch the samples of the first across it.
    width = np.minimum(following - values, 2 * usual)
    place = np.arange(len(stamps_ns)) - np.repeat(first, counts)
    # The first value may have begun before, the last may go on: their samples are as far apart as the others'.
    usual_count = float(np.median(counts[1:-1])) if len(counts) > 2 else float(counts.max())
    step = width / np.maximum(counts, 1)
    step[0] = width[0] / max(usual_count, counts[0])
    step[-1] = usual / max(usual_count, counts[-1])
    begin = np.zeros(len(values))
    begin[0] = width[0] - step[0] * counts[0]
    offset = np.repeat(begin, counts) + place * np.repeat(step, counts)
    return stamps_ns + np.round(offset).astype(np.int64), float(np.mean(counts))


def even_times(count: int, rate_hz: float) -> IntArray:
    """Return the times (count,) of samples at an even rate, nanoseconds from the first."""
    ticks: Any = np.round(np.arange(count) * 1e9 / rate_hz)
    return np.asarray(ticks.astype(np.int64))
