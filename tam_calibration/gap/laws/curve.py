"""The course of a law as a curve with its error."""

import numpy as np

from tam_calibration.gap.laws.candidates import Candidate
from tam_calibration.gap.laws.decisions import POINTS
from tam_calibration.gap.laws.law import Course
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


def curve_of(law: Candidate, residual: Residual) -> Course:
    """Return the course of a law that was found in a residual.

    The size is that of the shift of the readings along the direction in which it is largest; for a gain, of the
    coefficients, as a part of the field. A course in time has the errors of its process; that of a law with constant
    coefficients has the relative error 1/√(2 L) of their size, with L its log evidence.
    """
    fit = law.fitted(residual, with_errors=True)
    _, size = law.pattern.scaled(residual)
    in_time = law.bins is not None and law.pattern.law != "own_field"
    if in_time:
        mean, deviation = _coefficients(law, residual, fit.mean, fit.deviation)
    else:
        shift = law.pattern.features @ fit.mean[0]
        mean, deviation = shift, None
    is_gain = in_time and law.pattern.law == "gain"
    unit = residual.unit_T / size / (residual.field_T if is_gain else 1.0)
    direction = np.linalg.svd(mean - mean.mean(axis=0), full_matrices=False)[2][0]
    direction = direction * np.sign(direction[np.abs(direction).argmax()])
    along = mean @ direction * unit
    relative = np.abs(along).max() / np.sqrt(2 * law.evidence)
    error = np.full(len(along), relative) if deviation is None else np.sqrt(deviation**2 @ direction**2) * unit
    taken = np.unique(np.linspace(0, len(along) - 1, POINTS).round().astype(int))
    return Course(residual.time_s[taken], along[taken], error[taken], "1" if is_gain else "T")


def _coefficients(
    law: Candidate, residual: Residual, mean: FloatArray, deviation: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return the coefficients (N, p) of the pattern at every sample, and their standard deviations."""
    assert law.bins is not None
    if not law.steps:
        by_sample = law.bins.spread(mean, residual.count)
        error = None if deviation is None else law.bins.spread(deviation, residual.count)
        if law.direction is not None:
            by_sample = by_sample * law.direction
            error = None if error is None else error * np.abs(law.direction)
        return by_sample, error
    bin_of = law.bins.spread(np.arange(len(law.bins.place)), residual.count)
    passed = np.searchsorted(law.steps, bin_of, side="right")
    if law.begins_on is not None:
        return ((passed + law.begins_on) % 2)[:, None] * mean[0], None
    levels = np.vstack([np.zeros((1, mean.shape[1] // len(law.steps))), mean[0].reshape(len(law.steps), -1)])
    return np.asarray(np.cumsum(levels, axis=0)[passed]), None
