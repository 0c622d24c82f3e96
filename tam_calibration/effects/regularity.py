"""Regularities of an excess of variance, which show that noise is not its cause."""

import numpy as np

from tam_calibration.effects.excess_variance import Excess
from tam_calibration.effects.grades import CERTAIN, LEAST_SAMPLES, LONGEST_BURST, MOST, NEGLIGIBLE, NOTABLE, SLIGHT
from tam_calibration.effects.motion import MOST_NEIGHBOURS
from tam_calibration.effects.term import WhitenedResiduals, row_deviations
from tam_calibration.model.units import FloatArray

_OTHER_TIMES = 16
"""Time shifts of the excess against the field, forwards and reversed, that serve as surrogates."""

_NEIGHBOURS = 16
"""Nearest directions among which one is searched that is far in time."""

HEAVY = 3.0
"""Excess kurtosis, within blocks of samples, from which the excess consists of spikes."""

_BLOCK = 50
"""Samples of a block, within which the variance is taken as constant."""

_BANDS = 40
"""Bands of the spectrum, of which one may hold a line."""


def objection_to(residuals: WhitenedResiduals, excess: Excess) -> str | None:
    """Return in one clause which regularity excludes noise as the cause of an excess, or None.

    Parameters
    ----------
    residuals : WhitenedResiduals
        Residuals with the excess in them.
    excess : Excess
        Its row of largest excess variance is tested.
    """
    counted = residuals.is_counted
    largest = int(np.argmax(excess.part))
    row = excess.place.rows[largest]
    deviation = row_deviations(residuals)[counted, row]
    variance = float(np.mean(deviation**2))
    surplus = max(variance - excess.floor, 1e-3 * variance)
    chance = CERTAIN * variance / float(np.sqrt(len(deviation)))
    if neighbour_covariance(deviation) > max((1 - NOTABLE) * surplus, chance):
        return "the excess follows a course in time"
    if _line_part(deviation, excess.floor) > MOST:
        return "the excess stands in a line of the spectrum"
    direction = (residuals.covariates.field_T / residuals.covariates.intensity_T[:, None])[counted]
    if _directed(deviation, direction) > max(NOTABLE * surplus, chance):
        return "the excess follows the direction of the field"
    # The less of a row lies along the field, the more precise are its residual and its excess.
    expected = 1 + excess.part[largest] * residuals.row_information[counted, row]
    follows = _of_size(deviation / np.sqrt(expected), direction)
    if follows is not None:
        return follows
    if abs(_sidedness(deviation)) > CERTAIN:
        return "the excess goes to one side"
    kurtosis = _kurtosis(deviation)
    if kurtosis > HEAVY:
        return "the excess comes as spikes"
    if kurtosis < min(-MOST, -CERTAIN * float(np.sqrt(24 / len(deviation)))):
        return "the excess goes between few values"
    return None


def _of_size(deviation: FloatArray, direction: FloatArray) -> str | None:
    """Return in one clause what the size of an excess depends on, or None where it is constant."""
    size = deviation**2
    # The third square is what the other two leave of one.
    squares = np.column_stack([direction[:, :2] ** 2, direction * np.roll(direction, 1, axis=1)])
    if _follows(size, squares):
        return "the size of the excess follows the direction of the field"
    changes = [
        np.gradient(direction, axis=0),
        np.diff(direction, 2, axis=0, prepend=direction[:1], append=direction[-1:]),
    ]
    if _follows(size, np.column_stack([np.sum(change**2, axis=1) for change in changes])):
        return "the size of the excess follows the rate of the field"
    return None


def neighbour_covariance(deviation: FloatArray) -> float:
    """Return the mean covariance with the next three samples."""
    return float(np.mean([np.mean(deviation[lag:] * deviation[:-lag]) for lag in (1, 2, 3)]))


def _line_part(deviation: FloatArray, floor: float) -> float:
    """Return the largest part of the excess in one of 40 bands of the spectrum, the lowest tenth excluded."""
    power = np.abs(np.fft.rfft(deviation)[1:]) ** 2 / len(deviation) - floor
    if len(power) < 2 * _BANDS:
        return 0.0
    bands = np.array([band.sum() for band in np.array_split(power, _BANDS)])
    return float(bands[_BANDS // 10 :].max() / max(bands.sum(), np.finfo(float).tiny))


def _directed(deviation: FloatArray, direction: FloatArray) -> float:
    """Return the covariance of samples with those of the nearest direction at a distant time."""
    from scipy.spatial import cKDTree

    every = max(1, len(deviation) // MOST_NEIGHBOURS)
    chosen, values = direction[::every], deviation[::every]
    count = min(_NEIGHBOURS, len(values) - 1)
    _, near = cKDTree(chosen).query(chosen, count + 1)
    is_far = np.abs(near - np.arange(len(values))[:, None]) > SLIGHT * len(values)
    found = is_far.any(axis=1)
    nearest = near[np.arange(len(values)), np.argmax(is_far, axis=1)]
    products = (values * values[nearest])[found]
    return float(np.mean(products)) if len(products) > LEAST_SAMPLES else 0.0


def _follows(values: FloatArray, functions: FloatArray) -> bool:
    """Return whether functions (N, P) explain values (N,) beyond chance, and better than values shifted in time.

    The explained part of the variance of the ranks, times N, is χ² with P degrees of freedom whatever the distribution
    of independent values (Conover and Iman, Am. Stat. 35, 1981, p. 124).
    """
    from scipy.special import chdtri, ndtr

    basis = np.linalg.qr(functions - functions.mean(axis=0))[0]

    def explained(course: FloatArray) -> float:
        course = course - course.mean()
        return float(np.sum((basis.T @ course) ** 2)) / max(float(course @ course), np.finfo(float).tiny)

    ranks = np.argsort(np.argsort(values)).astype(float)
    if len(values) * explained(ranks) < chdtri(basis.shape[1], 2 * ndtr(-CERTAIN)):
        return False
    shifts = np.linspace(0, len(values), _OTHER_TIMES, endpoint=False).astype(int).tolist()
    parts = [explained(np.roll(own, shift)) for own in (values, values[::-1]) for shift in shifts]
    return parts[0] - max(parts[1:]) > NEGLIGIBLE


def _sidedness(deviation: FloatArray) -> float:
    """Return the sum of the cubes in its standard deviations under random signs of bursts of samples."""
    count = len(deviation) // LONGEST_BURST * LONGEST_BURST
    bursts = np.sum(deviation[:count].reshape(-1, LONGEST_BURST) ** 3, axis=1)
    return float(bursts.sum() / np.sqrt(np.sum(bursts**2)))


def _kurtosis(deviation: FloatArray) -> float:
    """Return the excess kurtosis within blocks of samples, so that intermittent noise has none."""
    blocks = max(1, len(deviation) // _BLOCK)
    square = deviation[: len(deviation) // blocks * blocks].reshape(blocks, -1) ** 2
    ratio = np.mean(square**2, axis=1) / np.maximum(np.mean(square, axis=1) ** 2, np.finfo(float).tiny)
    return float(np.mean(ratio)) - 3.0
