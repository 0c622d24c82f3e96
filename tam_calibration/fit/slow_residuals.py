"""By how much the errors of a fit vary more than white noise of the stated size makes them.

Residuals of a real recording are those of noise and of what no calibration holds: the gradient of a room, a current, an
hysteresis. These last for many samples, which then tell less than as many independent ones. What moves the estimate is
the sum over the samples of their scores. Their sums weighted by slow cosines vary as it does (``core.slow_cosines``),
and are compared with the variance that white noise of the stated size gives them, all parameters together: each alone
would have too few degrees of freedom.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.slow_cosines import BLOCKS, slow_cosines
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.information import rows_by_unknowns
from tam_calibration.fit.likelihood import UniformLikelihood
from tam_calibration.fit.scale import Normalized
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import FloatArray

_BEYOND = 3.09
"""Standard deviations of a normal law beyond which white noise of the stated size is once in a thousand recordings: as
often standard errors are widened without need."""

_SEEN = 1e-9
"""Part of the largest eigenvalue of a scaled information below which a direction is open."""


def variance_factor(calibration: Calibration, recording: SampleSource) -> float:
    """Return the variance of the errors of a fit over that of the inverse information.

    Parameters
    ----------
    calibration : Calibration
        With the noise that the information counts with.
    recording : SampleSource
        That it was fitted to, an ambient gradient taken off.

    Returns
    -------
    float
        1 where white noise of the stated size makes as much at least once in a thousand recordings, or where there are
        too few samples to tell; else more than 1.
    """
    if recording.sample_count < BLOCKS:
        return 1.0
    information, score = _by_block(calibration, recording)
    white = whitening(information.sum(axis=0), _SEEN)
    information, score = white.T @ information @ white, score @ white
    # What a fit by other weights left of the sum is no sign of slowness.
    score = score - score.sum(axis=0) @ information
    cosines = slow_cosines()
    energy = float(np.sum((cosines.T @ score) ** 2))
    taken = np.einsum("bc,bpq->cpq", cosines, information)
    covariance = np.einsum("bc,bd,bpq->cdpq", cosines, cosines, information, optimize=True)
    covariance -= np.einsum("cpr,drq->cdpq", taken, taken)
    expected = float(np.einsum("ccpp->", covariance))
    if expected <= 0:
        return 1.0
    # A sum of squares of unequal variances is nearly a multiple of a χ² (Satterthwaite 1946), the cube root of which is
    # nearly normal (Wilson and Hilferty 1931).
    variance = 2 / 9 * float(np.sum(covariance**2)) / expected**2
    deviation = (np.cbrt(energy / expected) - 1 + variance) / np.sqrt(variance)
    return energy / expected if deviation > _BEYOND else 1.0


def widened(calibration: Calibration, recording: SampleSource) -> Calibration:
    """Return a calibration of maximum likelihood with standard errors that hold what its residuals show.

    Parameters
    ----------
    calibration : Calibration
        With the inverse of the information for its covariance.
    recording : SampleSource
        As for ``variance_factor``.
    """
    assert calibration.covariance is not None
    factor = variance_factor(calibration, recording)
    return replace(with_variance_factor(calibration, factor), covariance=factor * calibration.covariance)


def with_variance_factor(calibration: Calibration, factor: float) -> Calibration:
    """Return a calibration that says by which factor the variances of its errors exceed those of white noise."""
    if factor == 1:
        return calibration
    return replace(calibration, reduced_chi_square=calibration.reduced_chi_square | {"slow": factor})


def _by_block(calibration: Calibration, recording: SampleSource) -> tuple[FloatArray, FloatArray]:
    """Return information (M, Q, Q) and score (M, Q) of the errors, and of a free intensity, in blocks of time."""
    errors, array, intensity_T = calibration.errors, calibration.array, calibration.intensity_T
    has_scalar = recording.scalar_count is not None
    # A common turn of all sensors is seen by no uniform field.
    rows = np.delete(rows_by_unknowns(errors, intensity_T, None if has_scalar else intensity_T), np.s_[9:12], axis=1)
    vector_noise, centered = array.vector_noise_T / intensity_T, np.zeros_like(errors.bias_T)
    scalar_noise = array.scalar_noise_T / intensity_T if has_scalar else 0.0
    information = np.zeros((BLOCKS, rows.shape[1], rows.shape[1]))
    score = np.zeros((BLOCKS, rows.shape[1]))
    for block, part in _parts(recording):
        data = Normalized(part, errors.bias_T, intensity_T, has_scalar)
        here = UniformLikelihood(data, vector_noise, scalar_noise).linearize(errors.matrix, centered)
        information[block] += rows.T @ here.information @ rows
        score[block] += rows.T @ here.gradient
    return information, score


def _parts(recording: SampleSource) -> Iterator[tuple[int, Recording]]:
    """Yield the samples in the order of time, each part with the number of the block that it belongs to."""
    bounds, first = np.linspace(0, recording.sample_count, BLOCKS + 1).astype(int), 0
    for samples in recording.blocks():
        last = first + len(samples.time_s)
        inside = bounds[(bounds > first) & (bounds < last)]
        for start, stop in pairwise([first, *inside.tolist(), last]):
            part = slice(start - first, stop - first)
            scalar_T = None if samples.scalar_T is None else samples.scalar_T[part]
            block = int(np.searchsorted(bounds, start, side="right")) - 1
            yield block, Recording(samples.time_s[part], samples.readings_T[part], scalar_T)
        first = last
