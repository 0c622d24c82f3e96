"""The reference intensity between the readings of a scalar magnetometer that is slower than the sensors.

Between two readings the intensity is the straight line, and that it is not straight is told by how far the readings
themselves lie off the line between their neighbours. All samples between two readings share the errors of both: a
reading that is counted once for each of them would count hundreds of times.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from tam_calibration.units import FloatArray

if TYPE_CHECKING:
    from scipy.sparse import csr_array

_LONGEST_GAP = 3.0
"""Gaps between readings are bridged up to this multiple of the usual one."""

_LARGEST_SHARE = 0.5
"""Largest part of the samples with a reading of their own at which interpolation is worth its time."""

_BANDWIDTH = 2
"""Errors further apart in the order of ``SharedNoise`` enter no sample together."""


@dataclass(frozen=True, eq=False)
class SharedNoise:
    """Independent errors of unit variance that samples share.

    Parameters
    ----------
    loading : (N, L) sparse array
        Standard deviation with which each error enters each sample: those of reading 1, of the curve between
        readings 1 and 2, of reading 2, and so on.
    """

    loading: "csr_array"

    def explained(self, known: np.ndarray, weighted: FloatArray, precision: FloatArray) -> FloatArray:
        """Return by how much shared errors lessen the second moments of columns X of the samples that are known.

        With weighted = D⁻¹ X, precision the diagonal of D⁻¹ and H the loading, (D + H Hᵀ)⁻¹ =
        D⁻¹ - D⁻¹ H (1 + Hᵀ D⁻¹ H)⁻¹ Hᵀ D⁻¹; what is returned is the second term between Xᵀ and X.
        """
        from scipy.linalg import solveh_banded

        loading = self.loading[known]
        seen = loading.T @ weighted
        inner = (loading.T @ loading.multiply(precision[:, None])).tocsr()
        bands = np.zeros((_BANDWIDTH + 1, inner.shape[0]))
        for below in range(min(_BANDWIDTH + 1, inner.shape[0])):
            bands[below, : inner.shape[0] - below] = inner.diagonal(-below)
        bands[0] += 1
        explained: FloatArray = seen.T @ solveh_banded(bands, seen, lower=True)
        return explained


@dataclass(frozen=True, eq=False)
class Reference:
    """The intensity at each sample.

    Parameters
    ----------
    intensity : (N,) array
        Read or interpolated; NaN before the first reading, after the last, and in long gaps.
    noise : SharedNoise
        Its errors.
    """

    intensity: FloatArray
    noise: SharedNoise

    @property
    def standard_deviation(self) -> FloatArray:
        """(N,) standard deviation of each sample's intensity; 0 where there is none."""
        variance: FloatArray = self.noise.loading.power(2).sum(axis=1)
        return np.sqrt(variance)


def is_worth_interpolating(scalar: FloatArray) -> bool:
    """Whether at least three samples (N,) hold a reading, and at most every second one."""
    known = np.isfinite(scalar)
    return bool(3 <= known.sum() <= _LARGEST_SHARE * len(scalar))


def interpolate(time_s: FloatArray, scalar: FloatArray, noise: float) -> Reference:
    """Return the intensity at every sample between the readings of a slower scalar magnetometer.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, increasing, seconds.
    scalar : (N,) array
        Readings, at least three; NaN where there is none. Any unit.
    noise : float
        Standard deviation of a reading, in the same unit.

    Returns
    -------
    Reference
        Between readings at a distance Δ the variance is that of the line between two noisy ends, and q Δ λ (1 - λ) at
        the part λ of the way: that of a random walk tied to both ends, with the rate q of ``_wander``. It is taken as
        one error for the whole way.
    """
    from scipy.sparse import coo_array

    known = np.flatnonzero(np.isfinite(scalar))
    when, reading = time_s[known], scalar[known]
    gap = np.diff(when)
    is_bridged = gap <= _LONGEST_GAP * np.median(gap)
    rate = _wander(when, reading, noise, is_bridged)
    before = np.clip(np.searchsorted(when, time_s, side="right") - 1, 0, len(when) - 2)
    way = (time_s - when[before]) / gap[before]
    inside = (way >= 0) & (way <= 1) & (is_bridged[before] | (way == 0) | (way == 1))
    way = np.where(inside, way, 0.0)
    intensity = np.where(inside, (1 - way) * reading[before] + way * reading[before + 1], np.nan)
    loadings = [(1 - way) * noise, np.sqrt(rate * gap[before] * way * (1 - way)), way * noise]
    rows = np.flatnonzero(inside)
    values = np.concatenate([loading[inside] for loading in loadings])
    columns = np.concatenate([2 * before[inside] + place for place in range(3)])
    shape = (len(time_s), 2 * len(when) - 1)
    return Reference(intensity, SharedNoise(coo_array((values, (np.tile(rows, 3), columns)), shape).tocsr()))


def _wander(when_s: FloatArray, reading: FloatArray, noise: float, is_bridged: np.ndarray) -> float:
    """Return the rate, in squared units per second, of a random walk that goes through the readings.

    A reading lies off the line between its neighbours by the noise of the three, and by a walk tied to both.
    """
    gap = np.diff(when_s)
    way = gap[:-1] / (gap[:-1] + gap[1:])
    off_line = reading[1:-1] - (1 - way) * reading[:-2] - way * reading[2:]
    by_noise = noise**2 * (1 + (1 - way) ** 2 + way**2)
    by_walk = gap[:-1] * gap[1:] / (gap[:-1] + gap[1:])
    tied = is_bridged[:-1] & is_bridged[1:]
    if not tied.any():
        return 0.0
    return float(max(0.0, np.sum((off_line**2 - by_noise)[tied]) / by_walk[tied].sum()))
