"""Axes with a stuck bit: their values leave out every second band of equal width, where the other sensors have some."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tam_calibration.integrity.fault import Fault, between, channel, in_nanotesla
from tam_calibration.integrity.overview import Overview
from tam_calibration.integrity.values import rounding
from tam_calibration.model.units import FloatArray

CELLS = 2048
"""Cells of a histogram of values: a period is told from four of them on."""

FEWEST_PERIODS = 2.5
"""Periods in the range of the values at least: fewer bands are no pattern."""

FEWEST_ALONE = 16.0
"""The same where no other sensor tells that the motion leaves nothing out: fewer bands may be visited attitudes."""

DIFFERENT = 100
"""Values that differ by a sixteenth of a period where no other sensor tells it: the poses of a turntable are fewer."""

COHERENT = 0.5
"""Least mean of the phases: values that fill half of each period have 2 / pi, those that fill all of it none."""

EMPTY = (0.45, 0.8)
"""Part of a period that is left out: half by one bit, three quarters by two beside each other."""

FILLED = 7
"""Of eight equal parts of the rest, that hold values: a pure lattice of steps has them in one."""

PREDICTED = 0.2
"""Share of the readings that the other sensors predict to lie in what is left out: of half a period it is half."""

NEAR = 160
"""Values nearest to each other, in which short periods are looked for: the mean of their phases errs by 0.08."""


@dataclass(frozen=True)
class _Bands:
    """Where values lie: from the phase ``first`` on, in a part ``filled`` of each period, counted from an origin."""

    period_T: float
    origin_T: float
    first: float
    filled: float

    def left_out(self, values: FloatArray) -> NDArray[np.bool_]:
        """Return which values (n,) lie where none should."""
        phase = (values - self.origin_T) / self.period_T
        return np.asarray((phase - self.first) % 1.0 > self.filled)

    @classmethod
    def of(cls, values: FloatArray, period_T: float) -> "_Bands | None":
        """Return the bands that values (n,) fill evenly; None where they leave out too little, or fill no bands."""
        phase = (values - values[0]) / period_T % 1.0
        ordered = np.sort(phase)
        gaps = np.diff(np.append(ordered, ordered[0] + 1))
        widest = int(gaps.argmax())
        empty, first = float(gaps[widest]), float(ordered[(widest + 1) % len(ordered)])
        if not EMPTY[0] <= empty <= EMPTY[1]:
            return None
        parts = (8 * ((phase - first) % 1.0) / (1 - empty)).astype(int).clip(0, 7)
        return cls(period_T, float(values[0]), first, 1 - empty) if len(np.unique(parts)) >= FILLED else None


def with_stuck_bits(overview: Overview) -> Iterator[Fault]:
    """Yield the axes that leave out bands of values."""
    parts = [(column, part) for column, row in enumerate(overview.sorted_T) for part in _parts(row)]
    told = set()
    for (column, part), cycles in zip(parts, _cycles([part for _, part in parts]), strict=True):
        bands = None if cycles is None or column in told else _bands(part, cycles)
        if bands is not None and _is_of_converter(overview, column, part, bands):
            told.add(column)
            sensor, axis = column // 3 + 1, "xyz"[column % 3]
            sentence = (
                f"{channel(sensor, axis)} leaves out every second band of {in_nanotesla(bands.period_T / 2)} "
                f"{between(overview.time_s)}: a bit of its converter is stuck"
            )
            yield Fault("stuck_bits", sensor, axis, overview.time_s, sentence)


def _parts(ordered: FloatArray) -> Iterator[FloatArray]:
    """Yield all values of increasing readings (n,), and those that lie nearest to each other."""
    values = ordered[np.append(True, np.diff(ordered) > rounding(ordered))]
    if len(values) >= DIFFERENT:
        yield values
    if len(values) >= 2 * NEAR:
        start = int(np.argmin(values[NEAR:] - values[:-NEAR]))
        yield values[start : start + NEAR]


def _cycles(parts: list[FloatArray]) -> list[float | None]:
    """Return how many periods at which the phases agree best fit into the range of each part; None: they do not agree.

    To half a period: with as many zeros behind, a histogram has two frequencies for each period.
    """
    histogram = np.empty((len(parts), CELLS))
    for row, values in zip(histogram, parts, strict=True):
        place = (values - values[0]) / (values[-1] - values[0]) * (CELLS - 1)
        row[:] = np.bincount((place + 0.5).astype(np.intp), minlength=CELLS) / len(values)
    coherence = np.abs(np.fft.rfft(histogram, 2 * CELLS, axis=1)[:, : CELLS // 2])
    coherence[:, : int(2 * FEWEST_PERIODS)] = 0
    best = coherence.argmax(axis=1)
    agree = coherence[range(len(parts)), best] >= COHERENT
    return [index / 2 * (CELLS - 1) / CELLS if is_one else None for index, is_one in zip(best, agree, strict=True)]


def _bands(values: FloatArray, cycles: float) -> _Bands | None:
    """Return the bands of increasing values (n,), of which a number fits into the range that is known to a half.

    Of the periods that may be meant it takes the one that leaves most out: where bands are few, unevenly filled ones
    agree best in their phases at another.
    """
    span = float(values[-1] - values[0])
    near = cycles + np.linspace(-0.5, 0.5, 33)
    ordered = np.sort((values - values[0]) / span * near[:, None] % 1.0, axis=1)
    gaps = np.diff(ordered, axis=1, append=ordered[:, :1] + 1)
    return _Bands.of(values, span / float(near[gaps.max(axis=1).argmax()]))


def _is_of_converter(overview: Overview, column: int, values: FloatArray, bands: _Bands) -> bool:
    """Whether bands are left out by a converter, and not by the motion."""
    if overview.sensor_count == 1:
        different = 1 + int((np.diff((16 * (values - values[0]) / bands.period_T).astype(int)) > 0).sum())
        return different >= DIFFERENT and float(values[-1] - values[0]) > FEWEST_ALONE * bands.period_T
    readings = overview.values_T
    others = np.delete(readings, range(column - column % 3, column - column % 3 + 3), axis=0)
    design = np.column_stack([others.T, np.ones(readings.shape[1])]) / np.abs(others).max()
    predicted = design @ np.linalg.lstsq(design, readings[column], rcond=None)[0]
    inside = predicted[(predicted > values[0]) & (predicted < values[-1])]
    return len(inside) > 0 and float(bands.left_out(inside).mean()) > PREDICTED
