"""The reference intensity between the readings of a scalar magnetometer that is slower than the sensors.

Between two readings the intensity is taken as the straight line, off which it wanders as a random walk that is tied to
both. The distances of the readings from the lines between their neighbours show how far it wanders.

All samples between two readings share the errors of both. Taken for their own, one reading would count hundreds of
times; the likelihood therefore needs the covariance of all samples, C = D + q B + σ² H Hᵀ: D the variances of the
sensors' field, B the walk's covariance within each interval at unit rate, H the two weights of each sample's line.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.model.units import FloatArray

LARGEST_SHARE = 0.5
"""Largest part of the samples with a reading of their own at which interpolation is worth its time."""


@dataclass(frozen=True, eq=False)
class InterpolationNoise:
    """The errors of the intensities of M samples between and at readings.

    Parameters
    ----------
    time_s : (M,) array
        Time stamps.
    interval : (M,) array of int
        Number of the reading before each sample.
    way : (M,) array
        Part of the way from there to the next reading, 0 to 1.
    gap_s : (M,) array
        Time between the two readings.
    noise : float
        Standard deviation of a reading.
    rate : float
        Squared wandering per second.
    """

    time_s: FloatArray
    interval: np.ndarray
    way: FloatArray
    gap_s: FloatArray
    noise: float
    rate: float

    @property
    def variance(self) -> FloatArray:
        """(M,) variances of the intensities, each by itself."""
        of_line = self.noise**2 * ((1 - self.way) ** 2 + self.way**2)
        of_walk: FloatArray = self.rate * self.gap_s * self.way * (1 - self.way)
        return of_line + of_walk

    def explained(self, weighted: FloatArray, precision: FloatArray) -> FloatArray:
        """Return Xᵀ D⁻¹ X - Xᵀ C⁻¹ X of F columns X of M samples.

        First the walk, by the tridiagonal inverse of B, then the readings: (A + U Uᵀ)⁻¹ = A⁻¹ - A⁻¹ U (1 + Uᵀ A⁻¹ U)⁻¹
        Uᵀ A⁻¹.

        Parameters
        ----------
        weighted : (M, F) array
            D⁻¹ X.
        precision : (M,) array
            Diagonal of D⁻¹.

        Returns
        -------
        (F, F) array
            What the shared errors take from the normal equations.
        """
        from scipy.linalg import solveh_banded

        line = self.noise * np.stack([1 - self.way, self.way], axis=1)
        columns = np.hstack([weighted, precision[:, None] * line])
        wandering = self._wandering(columns, precision)
        by_walk = weighted.T @ wandering[:, :-2]
        rest = columns - precision[:, None] * wandering
        at_readings = self._gather(line, rest[:, :-2])
        # The line's own part: 2 × 2 blocks of neighbouring readings, overlapping on the diagonal.
        size = len(at_readings)
        bands = np.zeros((2, size))
        bands[0] = 1
        for end in range(2):
            bands[0] += np.bincount(self.interval + end, line[:, end] * rest[:, end - 2], size)
        bands[1] = np.bincount(self.interval, line[:, 0] * rest[:, -1], size)
        by_readings: FloatArray = at_readings.T @ solveh_banded(bands, at_readings, lower=True)
        return by_walk + by_readings

    def _wandering(self, columns: FloatArray, precision: FloatArray) -> FloatArray:
        """Return q (B⁻¹ + q D⁻¹)⁻¹ times columns (M, F), zero at the readings."""
        from scipy.linalg import solveh_banded

        if self.rate == 0:
            return np.zeros_like(columns)
        free, bands = self._walk
        diagonal = np.where(free, bands[0] + self.rate * precision, 1.0)
        return np.asarray(
            solveh_banded(np.stack([diagonal, bands[1]]), np.where(free[:, None], self.rate * columns, 0.0), lower=True)
        )

    @cached_property
    def _walk(self) -> tuple[np.ndarray, FloatArray]:
        """Which samples lie between readings, and the (2, M) bands of the inverse of B."""
        free = (self.way > 0) & (self.way < 1)
        stiffness = 1 / np.diff(self.time_s)
        bands = np.zeros((2, len(free)))
        bands[0, 1:] += stiffness
        bands[0, :-1] += stiffness
        bands[1, :-1] = np.where(free[1:] & free[:-1], -stiffness, 0.0)
        return free, bands

    def _gather(self, line: FloatArray, columns: FloatArray) -> FloatArray:
        """Return σ Hᵀ times columns (M, F): a row for each reading."""
        from scipy.sparse import coo_array

        place = np.arange(len(line))
        rows = np.concatenate([self.interval, self.interval + 1])
        shape = (int(self.interval.max()) + 2, len(line))
        transposed = coo_array((line.T.ravel(), (rows, np.concatenate([place, place]))), shape)
        return np.asarray(transposed.tocsr() @ columns)


def is_worth_interpolating(scalar: FloatArray) -> bool:
    """Whether at least three samples (N,) hold a reading, and at most every second one."""
    known = np.isfinite(scalar)
    return bool(3 <= known.sum() <= LARGEST_SHARE * len(scalar))


def interpolate(time_s: FloatArray, scalar: FloatArray, noise: float) -> tuple[FloatArray, InterpolationNoise]:
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
    (N,) array
        Read or interpolated; NaN before the first reading, after the last, and in long gaps.
    InterpolationNoise
        The errors of those that are not NaN, and what they share.
    """
    known = np.flatnonzero(np.isfinite(scalar))
    when, reading = time_s[known], scalar[known]
    gap = np.diff(when)
    # Gaps between readings are bridged up to this multiple of the usual one.
    is_bridged = gap <= 3.0 * np.median(gap)
    interval = np.clip(np.searchsorted(when, time_s, side="right") - 1, 0, len(gap) - 1)
    way = (time_s - when[interval]) / gap[interval]
    inside = np.isfinite(scalar) | (is_bridged[interval] & (way > 0) & (way < 1))
    interval, way = interval[inside], way[inside]
    errors = InterpolationNoise(time_s[inside], interval, way, gap[interval], noise, _rate(when, reading, noise))
    intensity = np.full(len(time_s), np.nan)
    intensity[inside] = (1 - way) * reading[interval] + way * reading[interval + 1]
    return intensity, errors


def _rate(when_s: FloatArray, reading: FloatArray, noise: float) -> float:
    """Return the rate of the walk between readings, squared units per second.

    It is known for one and for two steps between readings and extrapolated to less than one: a walk has the same rate
    at all of them, a smooth curve an eighth of it at half the time.
    """
    one = _rate_over(when_s, reading, noise, 1)
    two = _rate_over(when_s, reading, noise, 2) if len(reading) > 4 else one
    # (1 / 8, 2.0): bounds of the ratio of the walk's rates at neighbouring octaves of time: smooth curves, and white
    # noise.
    return one * float(np.clip(one / max(two, np.finfo(float).tiny), *(1 / 8, 2.0))) if one > 0 else 0.0


def _rate_over(when_s: FloatArray, reading: FloatArray, noise: float, steps: int) -> float:
    """Return the rate of a walk whose readings lie as far off the lines between those some steps before and after.

    Such a reading lies off the line by the noise of the three, and by a walk that is tied to both ends.
    """
    before, after = (when_s[steps:-steps] - when_s[: -2 * steps]), (when_s[2 * steps :] - when_s[steps:-steps])
    way = before / (before + after)
    off_line = reading[steps:-steps] - (1 - way) * reading[: -2 * steps] - way * reading[2 * steps :]
    by_noise = noise**2 * (1 + (1 - way) ** 2 + way**2)
    return float(np.sum(off_line**2 - by_noise) / np.sum(way * after))
