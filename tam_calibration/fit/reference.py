"""The scalar magnetometer: the intensity between its readings, and whether it reads the field of the sensors.

Between two readings the intensity is taken as the straight line, off which it wanders as a random walk that is tied to
both. The distances of the readings from the lines between their neighbours show how far it wanders.

All samples between two readings share the errors of both. Taken for their own, one reading would count hundreds of
times; the likelihood therefore needs the covariance of all samples, C = D + q B + σ² H Hᵀ: D the variances of the
sensors' field, B the walk's covariance within each interval at unit rate, H the two weights of each sample's line.

In a uniform field the intensity does not depend on how the array is turned. Where the scalar does, it is near a
magnet, iron or a current, and the fit takes that for errors of all sensors, with small residuals. In terms of any
sensor's readings, which are an affine map of the field, every such dependence of a magnet and of soft iron is a
polynomial of second order. What slow cosines of time explain is left to the field of the site.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.noise import BLOCKS, SlowSums, complete_noise, slow_cosines
from tam_calibration.correction.acceptance import LARGEST_RELATIVE_ERROR
from tam_calibration.fit.coverage import ellipsoid_rows
from tam_calibration.model.array import Array
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.units import FloatArray, rounded, to_nanotesla


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
        from scipy.sparse import coo_array

        line = self.noise * np.stack([1 - self.way, self.way], axis=1)
        columns = np.hstack([weighted, precision[:, None] * line])
        wandering = self._wandering(columns, precision)
        by_walk = weighted.T @ wandering[:, :-2]
        rest = columns - precision[:, None] * wandering
        # σ Hᵀ times the columns: a row for each reading.
        place = np.concatenate([np.arange(len(line))] * 2)
        rows = np.concatenate([self.interval, self.interval + 1])
        transposed = coo_array((line.T.ravel(), (rows, place)), (int(self.interval.max()) + 2, len(line)))
        at_readings = transposed.tocsr() @ rest[:, :-2]
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


def is_worth_interpolating(source: SampleSource) -> bool:
    """Whether at least three samples hold a reading of the scalar, and at most every second one."""
    return 3 <= (source.scalar_count or 0) <= source.sample_count / 2


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


FOLLOWS = "the scalar follows the direction of the field"
"""How the sentence of a scalar begins that does."""


@dataclass(frozen=True)
class TurningScalar:
    """A scalar that follows the direction of the field.

    Parameters
    ----------
    mean_T : float
        Mean of its readings, tesla.
    size_T : float
        Size of the field that turns with the array at the scalar, tesla.
    is_most : bool
        Whether that is no chance, and explains most of what the scalar reads in addition to slow changes.
    """

    mean_T: float
    size_T: float
    is_most: bool

    @property
    def is_useless(self) -> bool:
        """Whether its mean leaves the scale of the sensors open, some of which exceeds 1 by up to a fifth."""
        return self.is_most and 1.2 * self.size_T > LARGEST_RELATIVE_ERROR * self.mean_T

    @property
    def sentence(self) -> str:
        """What it is and what became of it, for people."""
        used = "it is not used" if self.is_useless else "only its mean is used"
        counts = f"so {used}" if self.is_most else "and the standard errors include that"
        size = f"{rounded(to_nanotesla(self.size_T))} nT"
        return f"{FOLLOWS} by {size}, as near a magnet or a current, {counts}: move it away, or fit its heading error"


def turning_scalar(recording: SampleSource, array: Array) -> TurningScalar | None:
    """Return what a scalar reads that follows the direction of the field; None where it does not.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise.
    """
    some = recording.thinned(SKETCH)
    # 10 * BLOCKS: scalar readings: ten for each block of time.
    if some.scalar_T is None or np.count_nonzero(np.isfinite(some.scalar_T)) < 10 * BLOCKS:
        return None
    known = np.isfinite(some.scalar_T)
    scalar_T, field = some.scalar_T[known], some.readings_T[known].mean(axis=1)
    field, count = field / np.mean(norm(field, axis=1)), len(scalar_T)
    block = np.arange(count) * BLOCKS // count
    slow = np.linalg.qr(np.column_stack([np.ones(count), slow_cosines()[block]]))[0]
    left_T = scalar_T - slow @ (slow.T @ scalar_T)
    rows = ellipsoid_rows(field)
    rows = rows - slow @ (slow.T @ rows)
    # Part of the largest eigenvalue below which a column is the noise of the readings. The smallest of nine is the
    # sphere's own: it varies with the intensity, and not with the direction.
    columns = rows @ whitening(rows.T @ rows, 1e-6)[:, -8:]
    explained = columns.T @ left_T
    residual_T = left_T - columns @ explained
    noise_T = float(np.sqrt(np.sum(residual_T**2) / (count - columns.shape[1] - slow.shape[1])))
    edges = np.searchsorted(block, np.arange(1, BLOCKS))
    parts = list(zip(np.split(columns, edges), np.split(residual_T / noise_T, edges), strict=True))
    lasting = SlowSums.of(
        np.array([own.T @ own for own, _ in parts]), np.array([own.T @ left for own, left in parts])
    ).factor
    energy = float(explained @ explained)
    # The cube root of a χ² is nearly normal (Wilson and Hilferty 1931).
    variance = 2 / 9 / len(explained)
    deviation = (np.cbrt(energy / (len(explained) * noise_T**2 * lasting)) - 1 + variance) / np.sqrt(variance)
    # Standard deviations of a normal law from which standard errors hold what the dependence may do: once in a
    # hundred.
    if deviation < 2.33:
        return None
    noisy, _ = complete_noise(array, recording)
    variance_T2 = noise_T**2 + 1 / float(np.sum(1 / noisy.vector_noise_T**2))
    # Squared standard errors by which the dependence moves the errors, and which are not worth losing a scalar.
    is_harmful = energy > 4.0 * variance_T2 * lasting
    unit = np.column_stack([slow, field / norm(field, axis=1, keepdims=True)])
    # Of a magnet; soft iron, whose field is the same on both sides, is seen by the amplitude.
    of_magnet_T = float(norm(np.linalg.lstsq(unit, scalar_T, rcond=1e-6)[0][-3:]))
    size_T = max(of_magnet_T, np.sqrt(2 * energy / count))
    # Standard deviations of a normal law: once in ten thousand sound recordings.
    # Part of what is not slow that a magnet near the scalar explains at least: a field that varies faster may
    # follow the direction in part by chance.
    is_most = bool(deviation > 3.72 and is_harmful and energy >= 0.5 * float(left_T @ left_T))
    return TurningScalar(float(scalar_T.mean()), size_T, is_most)
