"""The power spectra of noises that residuals mix: each residual e = M n is a known sum of independent noises n.

The spectrum is that of several sine tapers (Riedel and Sidorenko, IEEE Trans. Signal Process. 43, 1995, p. 188), which
leak so little that noise as steep as a random walk keeps its slope, averaged over bands that grow with the frequency.
In each band the cross-spectra of the residuals have the mean M diag(S) Mᵀ. The S of greatest likelihood are found by
multiplicative updates, which keep them positive; the step is the ratio of the two parts of the gradient (Févotte,
Bertin and Durrieu, Neural Comput. 21, 2009, p. 793, here for covariances). What the residuals do not tell apart, as the
two of two sensors, keeps its common start: both get the mean.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.grades import LEAST_SAMPLES
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray

_TAPERS = 4
"""Sine tapers: they use 8/9 of the information, and resolve five parts of one over the duration."""

_BANDS_PER_OCTAVE = 16
"""Bands of the spectrum: 4 % wide, where that is more than the tapers resolve."""

_LONGEST_HOLE = 16
"""Samples of a hole that is filled with the course of the neighbours; a longer one is closed up."""

_OUTLIER = 5.0
"""Distance from the course of the neighbours, in robust standard deviations: normal noise has one in a million."""

_ROUNDS = 40
"""Multiplicative updates; spectra of equal sensors need ten."""

_LEAST_PART = 1e-9
"""Of the loudest row's power: the power of others is no smaller, so that covariances can be inverted."""

_NEIGHBOURS = 3
"""Bands on either side whose mean tells how certain the power in a band is."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Power of the noises of R rows in B bands. It is that of the samples: its mean over all bins is the variance.

    Parameters
    ----------
    step_s : float
        Median step of time.
    edges : (B + 1,) array
        Of the bands, cycles a sample.
    bins : (B,) array
        Independent frequencies in each band.
    power_T2 : (R, B) array
    freedom : (R, B) array
        Degrees of freedom of the power: as many as a χ² distribution with the same relative variance has.
    variance_T2 : (R,) array
        Of the samples, outliers left out.
    """

    step_s: float
    edges: FloatArray
    bins: IntArray
    power_T2: FloatArray
    freedom: FloatArray
    variance_T2: FloatArray

    @property
    def frequency(self) -> FloatArray:
        """(B,) centres of the bands, cycles a sample."""
        return (self.edges[1:] + self.edges[:-1]) / 2


def spectra_of(time_s: FloatArray, residual_T: FloatArray, mixing: FloatArray) -> Spectra:
    """Return the spectra of the noises that residuals mix.

    Parameters
    ----------
    time_s : (N,) array
        Increasing time stamps, seconds; they may jitter and have holes.
    residual_T : (N, R) array
        Tesla; a sample with a NaN is left out, and so is one with an outlier.
    mixing : (R, R) array
        Derivative of each residual by each row's noise.

    Raises
    ------
    InputError
        When fewer samples are left than tell a level.
    """
    is_finite = np.isfinite(residual_T).all(axis=1)
    if is_finite.sum() < LEAST_SAMPLES:
        raise InputError(f"the noise needs {LEAST_SAMPLES} samples without gaps, and there are {int(is_finite.sum())}")
    time, residual = time_s[is_finite], residual_T[is_finite]
    course = _course(residual)
    fits = _fits(residual - course)
    left, singular, _ = np.linalg.svd(mixing)
    independent = left[:, singular > 1e-9 * singular[0]]
    step = float(np.median(np.diff(time)))
    place = _places(time, step)
    series = _filled(place, np.where(fits[:, None], residual, course) @ independent)
    known = residual[fits] @ independent
    known -= known.mean(axis=0)
    count = series.shape[1]
    bounds, share = _bounds(count), len(known) / count
    cross = _cross_spectra(series, bounds) / share
    reduced = independent.T @ mixing
    bins = np.diff(bounds)
    information = 2 * bins * share / (1 + 1 / (2 * _TAPERS))
    return Spectra(
        step,
        (bounds - 0.5) / count,
        bins,
        _unmixed(cross, reduced).T,
        information * _certainty(cross, bins, reduced).T,
        _unmixed((known.T @ known / len(known))[None], reduced)[0],
    )


def _course(residual: FloatArray) -> FloatArray:
    """Return the running medians (N, R), which outliers do not move."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(residual, size=(_LONGEST_HOLE + 1, 1), mode="nearest"))


def _fits(deviation: FloatArray) -> NDArray[np.bool_]:
    """Return which samples (N,) have no outlier; a row that mostly stands still has none."""
    size = noise_deviation(deviation, axis=0)
    is_outlier: NDArray[np.bool_] = (np.abs(deviation) > _OUTLIER * size) & (size > 0)
    return np.logical_not(is_outlier.any(axis=1))


def _places(time_s: FloatArray, step_s: float) -> IntArray:
    """Return the places (N,) of samples on a lattice of time, in which long holes are closed up."""
    steps = np.maximum(np.rint(np.diff(time_s) / step_s), 1).astype(int)
    steps[steps > _LONGEST_HOLE] = 1
    return np.concatenate([[0], np.cumsum(steps)])


def _filled(place: IntArray, values: FloatArray) -> FloatArray:
    """Return the series (r, n) on the whole lattice about their means; holes go on the course of the neighbours."""
    every = np.arange(place[-1] + 1)
    is_hole = np.ones(len(every), dtype=bool)
    is_hole[place] = False
    series = np.empty((values.shape[1], len(every)))
    series[:, place] = values.T
    if is_hole.any():
        for own, course in zip(series, _course(values).T, strict=True):
            own[is_hole] = np.interp(every[is_hole], place, course)
    return np.asarray(series - series.mean(axis=1, keepdims=True))


def _bounds(count: int) -> IntArray:
    """Return the first bins of the bands of a spectrum of so many samples, and the end; the mean is in none."""
    bounds, end = [1], count // 2 + 1
    growth = 2 ** (1 / _BANDS_PER_OCTAVE) - 1
    while end - bounds[-1] >= 2 * max(_TAPERS, growth * bounds[-1]):
        bounds.append(bounds[-1] + max(_TAPERS, round(growth * bounds[-1])))
    return np.array([*bounds, end])


def _cross_spectra(series: FloatArray, bounds: IntArray) -> FloatArray:
    """Return the mean real cross-spectra (B, r, r) of series (r, n) in bands, with the tapers' mean."""
    count = series.shape[1]
    angle = np.pi * np.arange(1, count + 1) / (count + 1)
    cross = np.zeros((len(bounds) - 1, len(series), len(series)))
    for order in range(1, _TAPERS + 1):
        taper = np.sqrt(2 / (count + 1)) * np.sin(order * angle)
        transform = np.fft.rfft(series * taper)
        for own, (start, stop) in zip(cross, pairwise(bounds), strict=True):
            band = transform[:, start:stop]
            own += (band @ band.conj().T).real
    return np.asarray(cross / (_TAPERS * np.diff(bounds)[:, None, None]))


_LEAST_POWER_T2 = 1e-60
"""Far below the noise of any magnetometer: of a channel that is constant, whose power would be zero."""


def _unmixed(cross: FloatArray, reduced: FloatArray) -> FloatArray:
    """Return the powers (B, R) of greatest likelihood of the rows' noises, from cross-spectra (B, r, r)."""
    power = np.repeat(np.trace(cross, axis1=1, axis2=2)[:, None] / np.sum(reduced**2), reduced.shape[1], axis=1)
    power = np.maximum(power, _LEAST_POWER_T2)
    for _ in range(_ROUNDS):
        weighted = _weighted(power, reduced)
        found = np.sum(weighted * (cross @ weighted), axis=1)
        power = power * found / np.sum(weighted * reduced, axis=1)
        power = np.maximum(power, np.maximum(_LEAST_PART * power.max(axis=1, keepdims=True), _LEAST_POWER_T2))
    return np.asarray(power)


def _weighted(power: FloatArray, reduced: FloatArray) -> FloatArray:
    """Return the inverse covariances of the residuals times the mixing, (B, r, R)."""
    covariance = (reduced * power[:, None]) @ reduced.T
    return np.linalg.solve(covariance, np.broadcast_to(reduced, (len(power), *reduced.shape)))


def _certainty(cross: FloatArray, bins: IntArray, reduced: FloatArray) -> FloatArray:
    """Return by which factor (B, R) the information on a row's power is that of a noise that stands alone."""
    summed = np.cumsum(np.concatenate([np.zeros_like(cross[:1]), cross * bins[:, None, None]]), axis=0)
    first = np.maximum(np.arange(len(bins)) - _NEIGHBOURS, 0)
    last = np.minimum(np.arange(len(bins)) + _NEIGHBOURS + 1, len(bins))
    power = _unmixed(summed[last] - summed[first], reduced)
    shared = (np.swapaxes(_weighted(power, reduced), 1, 2) @ reduced) ** 2
    information = shared * power[:, :, None] * power[:, None]
    variance = np.diagonal(np.linalg.pinv(information, rcond=_LEAST_PART, hermitian=True), axis1=1, axis2=2)
    return 1 / np.maximum(variance, 1.0)
