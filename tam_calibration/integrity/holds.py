"""Axes that hold one value for a while, and readings that are exactly zero, in one pass through all samples."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.integrity.copies import is_chance
from tam_calibration.integrity.fault import Fault, between, channel, in_nanotesla
from tam_calibration.model.recording import Block, SampleSource
from tam_calibration.model.units import FloatArray

SHORTEST = 10
"""Samples of a hold: readings up to eight samples late are stale samples, an effect that is fitted with the errors."""

FINE = 0.1
"""Share of samples that repeat the one before. Below it an axis shows its noise, and a constant value is a fault."""

MOVED = 0.1
"""Fraction of their range through which others move at least where an axis of coarse steps should move too."""

STEPS = 2.0
"""Of the smallest change of an axis, by which it comes to rest or turns back: noise may add one."""

SAME = 0.8
"""Part of the longest hold in which all axes of a sensor hold at once where the sensor holds, not an axis alone."""


@dataclass(frozen=True)
class _Hold:
    """Columns of one sensor, one or all three, that hold a value; whether they show their noise elsewhere."""

    columns: tuple[int, ...]
    time_s: tuple[float, float]
    value_T: float
    is_fine: bool

    @property
    def is_of_sensor(self) -> bool:
        return len(self.columns) == 3


class Holds:
    """The longest hold of each axis, and what is zero.

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
        self._zeros, self._zero_s = np.zeros(sensor_count, dtype=int), np.zeros((sensor_count, 2))

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        self._add_zeros(block)
        values, index = block.readings_T.reshape(len(block.readings_T), -1), np.arange(len(block.time_s))[:, None]
        columns = np.arange(values.shape[1])
        change = np.abs(values - np.vstack([self._last, values[:-1]]))
        self._step_T = np.min(change, axis=0, where=change > 0, initial=np.inf).clip(max=self._step_T)
        changes = change != 0
        self._equal += len(values) - changes.sum(axis=0)
        # The hold of a sample began at the latest change, which may lie before the block.
        start = np.maximum.accumulate(np.where(changes, index, self._start - self._count), axis=0)
        end = (index - start).argmax(axis=0)
        first, last = start[end, columns], start[-1]
        since, self._start_s = (
            np.where(one < 0, self._start_s, block.time_s[np.maximum(one, 0)]) for one in (first, last)
        )
        held = np.stack([end - first + 1, values[end, columns], since, block.time_s[end]])
        self._longest = np.where(held[0] > self._longest[0], held, self._longest)
        self._start, self._last, self._count = last + self._count, values[-1].copy(), self._count + len(values)

    def _add_zeros(self, block: Block) -> None:
        for sensor in np.flatnonzero((block.readings_T[:, :, 0] == 0).any(axis=0)):
            zero = np.flatnonzero(~block.readings_T[:, sensor].any(axis=1))
            if len(zero):
                first = self._zero_s[sensor, 0] if self._zeros[sensor] else block.time_s[zero[0]]
                self._zero_s[sensor] = first, block.time_s[zero[-1]]
                self._zeros[sensor] += len(zero)

    def faults(self, source: SampleSource) -> list[Fault]:
        """Return what is wrong; the recording is read once more where something may be.

        Parameters
        ----------
        source : SampleSource
            What was added.
        """
        zeros = self._zero_faults()
        held = [hold for hold in self._holds() if hold.value_T != 0 or not self._zeros[hold.columns[0] // 3]]
        return zeros + (_frozen(_by_sensor(held), self._step_T, source) if held else [])

    def _zero_faults(self) -> list[Fault]:
        faults = []
        for sensor in np.flatnonzero(self._zeros):
            count, time_s = int(self._zeros[sensor]), (float(self._zero_s[sensor, 0]), float(self._zero_s[sensor, 1]))
            sentence = (
                f"sensor {sensor + 1} reads exactly zero on all axes in {count} sample{'s' * (count > 1)} "
                f"{between(time_s)}, which no sensor in a field does: its driver had no reading"
            )
            faults.append(Fault("zero", int(sensor) + 1, "", time_s, sentence, may_be_effect=count < self._count))
        return faults

    def _holds(self) -> list[_Hold]:
        """Return holds that are longer than chance makes them."""
        found = []
        for column, (equal, hold) in enumerate(zip(self._equal.tolist(), self._longest.T.tolist(), strict=True)):
            length, value_T, *time_s = hold
            share = (equal - length + 2) / (self._count - length + 2)
            if length >= SHORTEST and not is_chance(int(length) - 1, share, self._count):
                is_fine = share < FINE or length == self._count
                found.append(_Hold((column,), (time_s[0], time_s[1]), value_T, is_fine))
        return found


def _by_sensor(holds: list[_Hold]) -> list[_Hold]:
    """Return holds with those of all three axes of a sensor at one time as one."""
    found = []
    for sensor in sorted({hold.columns[0] // 3 for hold in holds}):
        own = [hold for hold in holds if hold.columns[0] // 3 == sensor]
        first, last = max(hold.time_s[0] for hold in own), min(hold.time_s[1] for hold in own)
        longest = max(hold.time_s[1] - hold.time_s[0] for hold in own)
        if len(own) == 3 and last - first >= SAME * longest:
            columns = tuple(hold.columns[0] for hold in own)
            own = [_Hold(columns, (first, last), own[0].value_T, any(hold.is_fine for hold in own))]
        found += own
    return found


def _frozen(holds: list[_Hold], step_T: FloatArray, source: SampleSource) -> list[Fault]:
    """Return those holds during which other axes move, and that end or begin with more than a step of the axis."""
    faults = []
    spans = [_Span(time_s, len(step_T)) for time_s in (*(hold.time_s for hold in holds), source.time_span_s)]
    for block in source.blocks():
        for span in spans:
            span.add(block)
    *during, complete = spans
    for hold, span in zip(holds, during, strict=True):
        if not hold.is_of_sensor and (not hold.is_fine or _is_at_end(hold, complete)):
            continue  # it may have turned about an axis of coarse steps; and the end of a range is saturation
        if _is_one_step(hold, span, step_T):
            continue
        part = np.divide(span.range_T, complete.range_T, out=np.zeros_like(step_T), where=complete.range_T > 0)
        moved = np.delete(part, hold.columns)
        if hold.is_fine if not len(moved) else moved.max() > (0 if hold.is_fine else MOVED):
            faults.append(_fault(hold, "the others move" if len(moved) else "its noise would show", source))
    return faults


def _is_at_end(hold: _Hold, complete: "_Span") -> bool:
    """Whether an axis holds an end of its range, and has one."""
    low_T, high_T = complete.low_T[hold.columns[0]], complete.high_T[hold.columns[0]]
    return bool(low_T < high_T and hold.value_T in (low_T, high_T))


def _is_one_step(hold: _Hold, span: "_Span", step_T: FloatArray) -> bool:
    """Whether an axis comes and goes by a step or two of its own: it may be at rest, or turn back."""
    columns = list(hold.columns)
    changes = np.abs(span.around_T[:, columns] - span.low_T[columns])
    return bool(np.isfinite(changes).any() and not (changes > STEPS * step_T[columns]).any())


def _fault(hold: _Hold, whose: str, source: SampleSource) -> Fault:
    sensor, axis = divmod(hold.columns[0], 3)
    name = "" if hold.is_of_sensor else "xyz"[axis]
    is_dead = hold.time_s == source.time_span_s
    value = "values" if hold.is_of_sensor else f"value, {in_nanotesla(hold.value_T)},"
    sentence = (
        f"{channel(sensor + 1, name)} reads the same {value} {'throughout, ' * is_dead}{between(hold.time_s)}, where "
        f"{whose}: it is frozen"
    )
    return Fault("frozen", sensor + 1, name, hold.time_s, sentence, may_be_effect=not is_dead)


class _Span:
    """Lowest and highest readings (3K,) during a span of time; (2, 3K) last before and first after it, or NaN."""

    def __init__(self, time_s: tuple[float, float], columns: int) -> None:
        self._time_s = time_s
        self.low_T, self.high_T = np.full(columns, np.inf), np.full(columns, -np.inf)
        self.around_T = np.full((2, columns), np.nan)

    @property
    def range_T(self) -> FloatArray:
        """(3K,) range of the readings."""
        return np.asarray(self.high_T - self.low_T)

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        values = block.readings_T.reshape(len(block.readings_T), -1)
        start = np.searchsorted(block.time_s, self._time_s[0])
        stop = np.searchsorted(block.time_s, self._time_s[1], side="right")
        if start < stop:
            self.low_T = np.minimum(self.low_T, values[start:stop].min(axis=0))
            self.high_T = np.maximum(self.high_T, values[start:stop].max(axis=0))
        if start > 0:
            self.around_T[0] = values[start - 1]
        if stop < len(values) and np.isnan(self.around_T[1]).all():
            self.around_T[1] = values[stop]
