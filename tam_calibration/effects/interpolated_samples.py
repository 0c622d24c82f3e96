"""Interpolated samples: lost readings that a driver filled on straight lines between their neighbours.

Where the field is in motion the line cuts its curve short: the residual is the error of linear interpolation, up to
h²/8 |d²b/dt²| for a gap of duration h, and the second differences of the readings vanish, as if the sensor had less
noise there and the field no curvature.
"""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.displaced import NOWHERE_T, Displaced, Explained, finding_of
from tam_calibration.effects.effect import (
    Contribution,
    Finding,
    FittedEffect,
    FoundEffect,
    Misfit,
    Situation,
)
from tam_calibration.effects.other_sensors import LEAST_SENSORS, AgainstOthers
from tam_calibration.effects.places import rows_of
from tam_calibration.units import FloatArray

LEAST_LENGTH = 4
"""Samples; what is shorter is no line, but may be any reading between its neighbours."""


class InterpolatedSamples(FoundEffect):
    """Lost readings of a sensor, filled on straight lines."""

    name = "interpolated_samples"
    title = "lost readings that were filled on straight lines"
    physics = (
        "Values put in place of lost ones hide the loss and understate the noise (Little and Rubin, Statistical "
        "Analysis with Missing Data, Wiley, 2002); a line errs by up to an eighth of the squared gap times the second "
        "derivative (de Boor, A Practical Guide to Splines, Springer, 1978, chapter 3)."
    )
    excitation = "turn the array steadily, with two sensors or more"
    units: ClassVar[Mapping[str, str]] = {"rate": "1", "burst": "1"}

    def obstacle(self, situation: Situation) -> str | None:
        """Return that there is no other sensor, where that is so."""
        return "one sensor alone does not tell how the field went" if situation.sensor_count < LEAST_SENSORS else None

    def find(self, misfit: Misfit) -> Finding | str:
        """Return the samples that were filled, flagged, or why there are none."""
        found = {}
        for sensor in range(misfit.situation.sensor_count):
            against = AgainstOthers.of(misfit, sensor).recalibrated()
            straight = Displaced(against, *_curvatures(against))
            windows = _windows(straight.which >= 0)
            if len(windows) and straight.is_found:
                found[sensor] = _explained(against, windows)
        if not found:
            return "no sensor reads along straight lines where the others see the field turn"
        return finding_of(self.name, misfit, found)

    def add(
        self, rows_T: FloatArray, situation: Situation, fitted: FittedEffect, generator: np.random.Generator
    ) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla."""
        rows, count = rows_T.copy(), situation.sample_count
        for part in fitted.contributions:
            burst = max(1, round(part.values["burst"]))
            starts = np.flatnonzero(generator.random(count) < part.values["rate"] / burst)
            for start in starts[(starts > 0) & (starts + burst < count)]:
                filled, ends = np.arange(start, start + burst), [start - 1, start + burst]
                for row in rows_of(part, situation):
                    rows[filled, row] = np.interp(filled, ends, rows_T[ends, row])
        return rows


def _curvatures(against: AgainstOthers) -> tuple[FloatArray, FloatArray]:
    """Return by how much the curvature of the readings (N, 3) is off, and by how much (1, N, 3) that of a line is."""
    beyond, bent = np.zeros_like(against.beyond_T), np.full_like(against.beyond_T, NOWHERE_T)
    for stretch in against.misfit.situation.stretches:
        inner = slice(stretch.start + 1, stretch.stop - 1)
        if inner.stop > inner.start:
            beyond[inner] = np.diff(against.beyond_T[stretch], 2, axis=0)
            bent[inner] = -np.diff(against.expected_T[stretch], 2, axis=0)
    return beyond, bent[None]


def _windows(is_straight: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the first and last sample (W, 2) of each row of straight samples that is long enough."""
    straight = np.flatnonzero(is_straight)
    if not len(straight):
        return np.zeros((0, 2), dtype=np.intp)
    cuts = np.flatnonzero(np.diff(straight) >= LEAST_LENGTH)  # the field itself may go straight for a sample or two
    windows: NDArray[np.intp] = np.column_stack(
        [straight[np.append(0, cuts + 1)], straight[np.append(cuts, len(straight) - 1)]]
    )
    is_long = windows[:, 1] - windows[:, 0] + 1 >= LEAST_LENGTH
    return windows[is_long]


def _explained(against: AgainstOthers, windows: NDArray[np.intp]) -> Explained:
    """Return the samples in windows, what lines between their ends leave of the residual, and the numbers."""
    count, left = len(against.beyond_T), against.beyond_T.copy()
    filled = np.zeros(count, dtype=bool)
    for first, last in windows:
        inside, ends = np.arange(first, last + 1), [max(first - 1, 0), min(last + 1, count - 1)]
        filled[inside] = True
        line = np.column_stack([np.interp(inside, ends, against.expected_T[ends, axis]) for axis in range(3)])
        left[inside] += against.expected_T[inside] - line
    rate, burst = float(filled.mean()), float(np.mean(np.diff(windows, axis=1))) + 1
    errors = {"rate": float(np.sqrt(rate * (1 - rate) / count))}
    return Explained(filled, left, Contribution(against.sensor, None, "lines", {"rate": rate, "burst": burst}, errors))
