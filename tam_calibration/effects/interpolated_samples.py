"""Interpolated samples: lost readings that a driver filled on straight lines between their neighbours.

Where the field is in motion the line cuts its curve short: the residual is the error of linear interpolation, up to
h²/8 |d²b/dt²| for a gap of duration h. Noise never goes straight in three axes at once: the second differences of what
was filled vanish, to the last digit that is written.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.displaced import AgainstOthers, Explained, drawn_bursts, finding_of
from tam_calibration.effects.effect import Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import NEGLIGIBLE
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.units import FloatArray

_ROUNDING = 1e-13
"""Rounding error relative to the largest reading: smaller steps are not those of the last decimal written."""


class InterpolatedSamples(FoundEffect):
    """Lost readings of a sensor, filled on straight lines."""

    name = "interpolated_samples"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no other sensor, where that is so."""
        return "one sensor alone does not tell how the field went" if covariates.sensor_count == 1 else None

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the samples that were filled, flagged, or why there are none."""
        found = []
        for sensor in range(residuals.covariates.sensor_count):
            windows = _lines(residuals.recording.readings_T[:, sensor], residuals.covariates)
            if windows:
                found.append(_explained(AgainstOthers.of(residuals, sensor).recalibrated(), windows))
        if not found:
            return "no sensor reads along straight lines where the others see the field turn"
        return finding_of(self.name, residuals, found, len(found), is_certain=True)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        rows, count = rows_T.copy(), len(rows_T)
        starts, burst = drawn_bursts(part, count, source)
        for start in starts[(starts > 0) & (starts + burst < count)]:
            filled, ends = np.arange(start, start + burst), [start - 1, start + burst]
            rows[filled] = np.column_stack([np.interp(filled, ends, own) for own in rows_T[ends].T])
        return rows


def _lines(readings_T: FloatArray, covariates: Covariates) -> list[NDArray[np.intp]]:
    """Return the samples of each row that goes straight in all axes and is longer than chance lets one be.

    Chance is that of the samples of which some axes go straight, and others do not.
    """
    count = len(readings_T)
    digit = np.array([_digit(axis) for axis in readings_T.T])
    bend, step = np.full((count, 3), np.inf), np.zeros((count, 3))
    for stretch in covariates.stretches:
        if stretch.stop - stretch.start > 2:
            bend[stretch.start + 1 : stretch.stop - 1] = np.diff(readings_T[stretch], 2, axis=0)
            step[stretch.start + 1 : stretch.stop] = np.diff(readings_T[stretch], axis=0)
    goes_straight = np.abs(bend) <= 2 * digit
    is_straight = goes_straight.all(axis=1) & (np.abs(step) > 4 * digit).any(axis=1)
    chance = float(np.prod((goes_straight[~is_straight].sum(axis=0) + 1) / (np.sum(~is_straight) + 1)))
    rows = np.split(np.arange(count), np.flatnonzero(np.diff(is_straight)) + 1)
    return [row for row in rows if is_straight[row[0]] and count * chance ** len(row) < NEGLIGIBLE]


def _digit(values: FloatArray) -> float:
    """Return the smallest step between values (N,) that differ by more than the rounding of the computer."""
    steps = np.diff(np.unique(values))
    return float(np.min(steps[steps > _ROUNDING * np.abs(values).max()], initial=np.ptp(values)))


def _explained(against: AgainstOthers, windows: Sequence[NDArray[np.intp]]) -> Explained:
    """Return the samples of the rows, what lines between their ends leave of the residual, and the numbers."""
    count, left = len(against.beyond_T), against.beyond_T.copy()
    filled = np.zeros(count, dtype=bool)
    for inside in windows:
        filled[inside], ends = True, [max(inside[0] - 1, 0), min(inside[-1] + 1, count - 1)]
        line = np.column_stack([np.interp(inside, ends, against.expected_T[ends, axis]) for axis in range(3)])
        left[inside] += against.expected_T[inside] - line
    rate, burst = float(filled.mean()), float(np.mean([len(row) for row in windows]))
    errors = {"rate": float(np.sqrt(rate * (1 - rate) / count))}
    return Explained(filled, left, Contribution(against.sensor, None, "lines", {"rate": rate, "burst": burst}, errors))
