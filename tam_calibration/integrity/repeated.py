"""What repeats: sensors that read what another read, at once or later; axes that keep one value; exact zeros.

All are found in one pass through the samples.
"""

from collections import defaultdict
from itertools import combinations
from math import log

import numpy as np

from tam_calibration.integrity.fault import Fault, Overview, between, channel, fault_of_axis, in_nanotesla
from tam_calibration.model.recording import Block, SampleSource
from tam_calibration.model.units import FloatArray

SHORTEST = 10
"""Samples of one value, and different readings that a copy repeats: readings up to eight samples late are stale
samples, an effect that is fitted as well."""


def _chance(length: int, equal: int, count: int) -> float | None:
    """Return how often readings are equal elsewhere; None where that may make so many equal ones in a row.

    Parameters
    ----------
    length : int
        Readings in the longest row of equal ones.
    equal : int
        Equalities before, in and after it.
    count : int
        Number of samples.
    """
    share = (equal - length + 2) / (count - length + 2)
    # Probability of a false alarm in one recording.
    is_chance = share >= 1 or (length - 1) * log(share) > log(1e-6 / count)
    return None if length < SHORTEST or is_chance else share


PROBES = 16
"""Readings of a sensor in each block that are looked for among those of the others."""


COPIED = 1 - 1e-13
"""Correlation of two axes that differ by rounding only; noise of a millionth of the readings' spread makes less."""


class _Pair:
    """The longest stretch in which one sensor reads what another read some samples before."""

    def __init__(self) -> None:
        self.longest, self.equal, self.late = 0, 0, 0
        self.time_s = 0.0, 0.0

    def add(self, copy: FloatArray, original: FloatArray, time_s: FloatArray, late: int) -> None:
        is_equal = copy == original
        is_new = np.append(True, copy[1:] != copy[:-1])
        self.equal += int((is_equal & is_new).sum())
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_equal, [False]]).astype(np.int8)))
        new = np.concatenate([[0], np.cumsum(is_new)])
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if (length := int(new[stop] - new[start])) > self.longest:
                self.longest, self.late = length, late
                self.time_s = float(time_s[start]), float(time_s[stop - 1])


class Copies:
    """Which sensor repeats which."""

    def __init__(self) -> None:
        self._count = 0
        self._pairs: dict[tuple[int, int], _Pair] = defaultdict(_Pair)

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        count, sensors, _ = block.readings_T.shape
        self._count += count
        weights = np.array([1.0, 0.6180339887498949, 0.41421356237309503])  # different readings get different numbers
        numbers = np.ascontiguousarray((block.readings_T.reshape(-1, 3) @ weights).reshape(count, sensors).T)
        for original, copy in combinations(range(sensors), 2):
            if (numbers[copy] == numbers[original]).any():
                self._pairs[copy, original].add(numbers[copy], numbers[original], block.time_s, 0)
        for copy, original, late in _lags(numbers):
            self._pairs[copy, original].add(numbers[copy, late:], numbers[original, :-late], block.time_s[late:], late)

    def faults(self, overview: Overview) -> list[Fault]:
        """Return what repeats what.

        Parameters
        ----------
        overview : Overview
            Of what was added.
        """
        faults, known = [], set()
        for (copy, original), pair in sorted(self._pairs.items()):
            if _chance(pair.longest, pair.equal - 1, self._count) is not None:
                known.add(frozenset((copy, original)))
                when = f" {pair.late} samples later" if pair.late else ""
                sentence = (
                    f"sensor {copy + 1} repeats sensor {original + 1}{when} {between(pair.time_s, overview.time_s)}: "
                    "it is no sensor of its own"
                )
                faults.append(Fault("repeated", copy + 1, "", pair.time_s, sentence))
        return faults + _axes(overview, known)


def _lags(numbers: FloatArray) -> list[tuple[int, int, int]]:
    """Return copy, original and how many samples later, where several probes (K, n) are met again."""
    count = numbers.shape[1]
    if count < 2 * PROBES:
        return []
    place = np.linspace(0, count - 1, PROBES + 2).astype(int)[1:-1]
    probes = numbers[:, place].ravel()
    order = np.argsort(probes)
    at = np.minimum(np.searchsorted(probes[order], numbers.ravel()), len(probes) - 1)
    met = np.flatnonzero(probes[order[at]] == numbers.ravel())
    copy, here = np.divmod(met, count)
    original, probe = np.divmod(order[at[met]], PROBES)
    late = here - place[probe]
    later = (copy != original) & (late > 0)
    found, times = np.unique(np.stack([copy, original, late])[:, later], axis=1, return_counts=True)
    # Of these, that are met again equally late, before a copy is looked for there.
    return [(int(k), int(j), int(lag)) for k, j, lag in found[:, times >= 4].T]


def _axes(overview: Overview, known: set[frozenset[int]]) -> list[Fault]:
    """Return the axes that repeat another but for scale and offset."""
    values, ordered, count = overview.values_T, overview.sorted_T, overview.sensor_count
    is_still = (ordered[:, 0] == ordered[:, -1]) | (values.var(axis=1) == 0)
    correlation: FloatArray = np.asarray(np.corrcoef(values))
    correlation[is_still | is_still[:, None]] = 0
    faults = []
    own = correlation.reshape(count, 3, count, 3)[range(count), :, range(count)]
    # Variance out of a plane of readings without noise, in units of theirs: axes agree there because the field does.
    is_flat = np.linalg.eigvalsh(own)[:, 0] < 1e-12
    for copy, original in np.argwhere(np.tril(np.abs(correlation) > COPIED, -1)).tolist():
        witnesses = is_flat if copy // 3 != original // 3 else np.delete(is_flat, copy // 3)
        if frozenset((copy // 3, original // 3)) not in known and not (len(witnesses) and witnesses.all()):
            other = channel(original // 3 + 1, "xyz"[original % 3])
            words = f"repeats {other} but for scale and offset throughout: it is no axis of its own"
            faults.append(fault_of_axis("repeated", copy, words, overview.time_s))
    return faults


FINE = 0.1
"""Share of samples that repeat the one before. Below it an axis shows its noise, and a constant value is a fault."""

MOVED = 0.1
"""Fraction of their range through which others move at least where an axis of coarse steps should move too."""

STEPS = 2.0
"""Of the smallest change of an axis, by which it comes to rest or turns back: noise may add one."""

SAME = 0.8
"""Part of the longest run in which all axes of a sensor are constant: the sensor is frozen, not an axis alone."""


class _Run:
    """Columns of one sensor, one or all three, that keep a value, and whether they show their noise elsewhere.

    Of a second pass: lowest and highest readings (3K,) during the run; (2, 3K) last before and first after it, or NaN.
    """

    def __init__(
        self, columns: list[int], time_s: tuple[float, float], value_T: float, is_fine: bool, all_columns: int
    ) -> None:
        self.columns, self.time_s, self.value_T, self.is_fine = columns, time_s, value_T, is_fine
        self.is_of_sensor = len(columns) == 3
        self.low_T, self.high_T = np.full(all_columns, np.inf), np.full(all_columns, -np.inf)
        self.around_T = np.full((2, all_columns), np.nan)

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        values = block.readings_T.reshape(len(block.readings_T), -1)
        start = np.searchsorted(block.time_s, self.time_s[0])
        stop = np.searchsorted(block.time_s, self.time_s[1], side="right")
        self.low_T = values[start:stop].min(axis=0, initial=np.inf).clip(max=self.low_T)
        self.high_T = values[start:stop].max(axis=0, initial=-np.inf).clip(min=self.high_T)
        if start > 0:
            self.around_T[0] = values[start - 1]
        if stop < len(values) and np.isnan(self.around_T[1]).all():
            self.around_T[1] = values[stop]


class FrozenAxes:
    """The longest run of each axis, and what is zero.

    Parameters
    ----------
    sensor_count : int
        Number of sensors K.
    """

    def __init__(self, sensor_count: int) -> None:
        columns = 3 * sensor_count
        self._count, self._equal = 0, np.zeros(columns, dtype=int)
        self._last, self._step_T = np.full(columns, np.nan), np.full(columns, np.inf)
        self._start, self._start_s = np.zeros(columns, dtype=int), np.zeros(columns)
        self._longest = np.repeat([[1.0], [0.0], [0.0], [0.0]], columns, axis=1)  # samples, value, first and last time
        self._zeros: dict[int, tuple[int, float, float]] = {}  # of each sensor, with first and last time

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        self._add_zeros(block)
        count, index = len(block.time_s), np.arange(len(block.time_s))
        values = np.ascontiguousarray(block.readings_T.reshape(count, -1).T)
        columns = np.arange(len(values))
        change = np.abs(np.diff(values, prepend=self._last[:, None]))
        self._step_T = np.min(change, axis=1, where=change > 0, initial=np.inf).clip(max=self._step_T)
        changes = change != 0
        self._equal += count - np.count_nonzero(changes, axis=1)
        # The run of a sample began at the latest change, which may lie before the block.
        start = np.maximum.accumulate(np.where(changes, index, (self._start - self._count)[:, None]), axis=1)
        end = (index - start).argmax(axis=1)
        first, last = start[columns, end], start[:, -1]
        since, self._start_s = (
            np.where(one < 0, self._start_s, block.time_s[np.maximum(one, 0)]) for one in (first, last)
        )
        latest = np.stack([end - first + 1, values[columns, end], since, block.time_s[end]])
        self._longest = np.where(latest[0] > self._longest[0], latest, self._longest)
        self._start, self._last, self._count = last + self._count, values[:, -1].copy(), self._count + count

    def _add_zeros(self, block: Block) -> None:
        for sensor in np.flatnonzero((block.readings_T[:, :, 0] == 0).any(axis=0)).tolist():
            zero_s = block.time_s[~block.readings_T[:, sensor].any(axis=1)].tolist()
            if zero_s:
                count, first_s, _ = self._zeros.get(sensor, (0, zero_s[0], 0.0))
                self._zeros[sensor] = count + len(zero_s), first_s, zero_s[-1]

    def faults(self, source: SampleSource) -> list[Fault]:
        """Return what is wrong; the recording is read once more where something may be.

        Parameters
        ----------
        source : SampleSource
            What was added.
        """
        zeros = self._zero_faults(source)
        constant = [run for run in self._runs() if run.value_T != 0 or run.columns[0] // 3 not in self._zeros]
        return zeros + (_frozen(_by_sensor(constant), self._step_T, source) if constant else [])

    def _zero_faults(self, source: SampleSource) -> list[Fault]:
        faults = []
        for sensor, (count, first_s, last_s) in sorted(self._zeros.items()):
            time_s = first_s, last_s
            sentence = (
                f"sensor {sensor + 1} reads exactly zero on all axes in {count} sample{'s' * (count > 1)} "
                f"{between(time_s, source.time_span_s)}, which no sensor in a field does: its driver had no reading"
            )
            faults.append(Fault("zero", sensor + 1, "", time_s, sentence, may_be_effect=count < self._count))
        return faults

    def _runs(self) -> list[_Run]:
        """Return runs that are longer than chance makes them."""
        found = []
        for column, (equal, run) in enumerate(zip(self._equal.tolist(), self._longest.T.tolist(), strict=True)):
            length, value_T, first_s, last_s = run
            share = _chance(length, equal, self._count)
            if share is not None:
                is_fine = share < FINE or length == self._count
                found.append(_Run([column], (first_s, last_s), value_T, is_fine, len(self._equal)))
        return found


def _by_sensor(runs: list[_Run]) -> list[_Run]:
    """Return runs with those of all three axes of a sensor at one time as one."""
    found = []
    for sensor in sorted({run.columns[0] // 3 for run in runs}):
        own = [run for run in runs if run.columns[0] // 3 == sensor]
        first, last = max(run.time_s[0] for run in own), min(run.time_s[1] for run in own)
        longest = max(run.time_s[1] - run.time_s[0] for run in own)
        if len(own) == 3 and last - first >= SAME * longest:
            columns = [run.columns[0] for run in own]
            own = [_Run(columns, (first, last), own[0].value_T, any(run.is_fine for run in own), len(own[0].low_T))]
        found += own
    return found


def _frozen(runs: list[_Run], step_T: FloatArray, source: SampleSource) -> list[Fault]:
    """Return those runs during which other axes move, and that end or begin with more than a step of the axis."""
    faults, complete = [], _Run([], source.time_span_s, 0.0, True, len(step_T))
    for block in source.blocks():
        for run in (*runs, complete):
            run.add(block)
    all_T = complete.high_T - complete.low_T
    for run in runs:
        low_T, high_T = complete.low_T[run.columns[0]], complete.high_T[run.columns[0]]
        is_at_end = low_T < high_T and run.value_T in (low_T, high_T)
        if not run.is_of_sensor and (not run.is_fine or is_at_end):
            continue  # it may have turned about an axis of coarse steps; and the end of a range is saturation
        changes = np.abs(run.around_T[:, run.columns] - run.low_T[run.columns])
        if np.isfinite(changes).any() and not (changes > STEPS * step_T[run.columns]).any():
            continue  # it comes and goes by a step or two of its own: it may be at rest, or turn back
        part = np.divide(run.high_T - run.low_T, all_T, out=np.zeros_like(step_T), where=all_T > 0)
        moved = np.delete(part, run.columns)
        if run.is_fine if not len(moved) else moved.max() > (0 if run.is_fine else MOVED):
            faults.append(_fault(run, "the others move" if len(moved) else "its noise would show", source))
    return faults


def _fault(run: _Run, whose: str, source: SampleSource) -> Fault:
    sensor, axis = divmod(run.columns[0], 3)
    name = "" if run.is_of_sensor else "xyz"[axis]
    is_dead = run.time_s == source.time_span_s
    value = "values" if run.is_of_sensor else f"value, {in_nanotesla(run.value_T)},"
    sentence = (
        f"{channel(sensor + 1, name)} reads the same {value} {between(run.time_s, source.time_span_s)}, where "
        f"{whose}: it is frozen"
    )
    return Fault("frozen", sensor + 1, name, run.time_s, sentence, may_be_effect=not is_dead)
