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
"""Share of samples that repeat the one before below which an axis shows its noise, so that none can stand still."""

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
        self._last = np.full(columns, np.nan)
        self._start, self._start_s = np.zeros(columns, dtype=int), np.zeros(columns)
        self._longest = np.repeat([[1.0], [0.0], [0.0], [0.0]], columns, axis=1)  # samples, value, first and last time
        self._zeros, self._zero_s = np.zeros(sensor_count, dtype=int), np.zeros((sensor_count, 2))

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        self._add_zeros(block)
        values, index = block.readings_T.reshape(len(block.readings_T), -1), np.arange(len(block.time_s))[:, None]
        columns = np.arange(values.shape[1])
        changes = values != np.vstack([self._last, values[:-1]])
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
        return zeros + (_frozen(_by_sensor(held), source) if held else [])

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


def _frozen(holds: list[_Hold], source: SampleSource) -> list[Fault]:
    """Return those holds during which other axes move, and that end or begin with more than a step of the axis."""
    faults = []
    around = _Around.of([hold.time_s for hold in holds], source)
    whole = around.high_T[-1] - around.low_T[-1]
    for number, hold in enumerate(holds):
        if not hold.is_of_sensor and (not hold.is_fine or _is_at_end(hold, around.low_T[-1], around.high_T[-1])):
            continue  # it may have turned about an axis of coarse steps; and the end of a range is saturation
        if around.is_one_step(number, hold):
            continue
        ranges = around.high_T[number] - around.low_T[number]
        moved = np.delete(np.divide(ranges, whole, out=np.zeros_like(whole), where=whole > 0), hold.columns)
        if hold.is_fine if not len(moved) else moved.max() > (0 if hold.is_fine else MOVED):
            faults.append(_fault(hold, "the others move" if len(moved) else "its noise would show", source))
    return faults


def _is_at_end(hold: _Hold, low: FloatArray, high: FloatArray) -> bool:
    """Whether an axis holds an end of its range (3K,), and has one."""
    (column,) = hold.columns
    return bool(low[column] < high[column] and hold.value_T in (low[column], high[column]))


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


@dataclass(frozen=True, eq=False)
class _Around:
    """What is read during some spans of time and last during all of it, beside them, and from sample to sample.

    Parameters
    ----------
    low_T, high_T : (spans + 1, 3K) arrays
        Lowest and highest readings.
    before_T, after_T : (spans + 1, 3K) arrays
        Last reading before and first one after; NaN where there is none.
    step_T : (3K,) array
        Smallest change from one sample to the next.
    """

    low_T: FloatArray
    high_T: FloatArray
    before_T: FloatArray
    after_T: FloatArray
    step_T: FloatArray

    @classmethod
    def of(cls, spans: list[tuple[float, float]], source: SampleSource) -> "_Around":
        """Return it of a recording, which is read once."""
        spans = [*spans, source.time_span_s]
        shape = len(spans), 3 * source.sensor_count
        low_T, before_T, after_T = np.full(shape, np.inf), np.full(shape, np.nan), np.full(shape, np.nan)
        found = cls(low_T, -low_T, before_T, after_T, np.full(shape[1], np.inf))
        last: FloatArray | None = None
        for block in source.blocks():
            values = block.readings_T.reshape(len(block.readings_T), -1)
            for number, span in enumerate(spans):
                found._add(number, span, block.time_s, values)
            last = found._add_steps(values if last is None else np.concatenate([last, values]))
        return found

    def _add(self, number: int, span: tuple[float, float], time_s: FloatArray, values: FloatArray) -> None:
        start, stop = np.searchsorted(time_s, span[0]), np.searchsorted(time_s, span[1], side="right")
        if start < stop:
            self.low_T[number] = np.minimum(self.low_T[number], values[start:stop].min(axis=0))
            self.high_T[number] = np.maximum(self.high_T[number], values[start:stop].max(axis=0))
        if start > 0:
            self.before_T[number] = values[start - 1]
        if stop < len(values) and np.isnan(self.after_T[number]).all():
            self.after_T[number] = values[stop]

    def _add_steps(self, values: FloatArray) -> FloatArray:
        change = np.abs(np.diff(values, axis=0))
        least = np.min(change, axis=0, where=change > 0, initial=np.inf)
        np.minimum(self.step_T, least, out=self.step_T)
        return values[-1:]

    def is_one_step(self, number: int, hold: _Hold) -> bool:
        """Whether an axis comes and goes by a step or two of its own: it may be at rest, or turn back."""
        columns = list(hold.columns)
        beside = np.stack([self.before_T[number, columns], self.after_T[number, columns]])
        changes = np.abs(beside - self.low_T[number, columns])
        return bool(np.isfinite(changes).any() and not (changes > STEPS * self.step_T[columns]).any())
