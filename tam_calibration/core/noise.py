"""Noise: its size, robust and from fast differences, and by how much its correlation in time increases variances.

Where the samples are stationary, a sum weighted by a slow cosine has the variance of the sum itself, whatever the
correlation is, as long as it ends within a fraction of the recording (Lazarus, Lewis, Stock and Watson, HAR inference:
recommendations for practice, J. Bus. Econ. Stat. 36, 2018, p. 541: equally weighted cosines). The weighted sums of
scores are compared with the variance that white noise of the stated size gives them, all parameters together: each
alone would have too few degrees of freedom.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.limits import LEAST_SPREAD_T
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.units import FloatArray


def noise_deviation(values: FloatArray, axis: int | None = None) -> FloatArray:
    """Return the standard deviation of normal noise whose absolute values have the same median, along an axis.

    Parameters
    ----------
    values : array
        Noise about zero, in any shape and unit.
    axis : int, optional
        Along which the median is taken; by default over all values.
    """
    from scipy.special import ndtri

    return np.asarray(np.median(np.abs(values), axis=axis) / ndtri(0.75))


def noise_energy(energy: FloatArray, freedom: int) -> float:
    """Return the variance of normal noise whose sums of squares have the same median as given ones.

    Parameters
    ----------
    energy : (N,) array
        Sums of squares.
    freedom : int
        Number of squares in each sum.
    """
    from scipy.special import chdtri

    return float(np.median(energy) / chdtri(freedom, 0.5))


def complete_noise(array: Array, source: SampleSource) -> tuple[KnownNoiseArray, bool]:
    """Return the array with every noise known, and whether one was estimated.

    A noise that is not stated is the robust scale of the third differences of its channel divided by √20, which is
    exact for white noise on a motion that is slow against the sampling. Attitudes that jump would pass for noise, so
    that no more than a fiftieth of the readings' spread is taken; the fit then scales it to the residual. A stated
    noise is kept. Of a recording of more than 100 000 samples some stretches serve.

    Parameters
    ----------
    array : Array
        Its noise stated or not.
    source : SampleSource
        Raw readings of its K sensors, tesla.
    """
    needs_scalar = array.scalar_noise_T is None and source.scalar_count is not None
    estimated = array.vector_noise_T is None or needs_scalar
    vector, scalar = array.vector_noise_T, 0.0 if array.scalar_noise_T is None else array.scalar_noise_T
    if estimated:
        readings, reference = _stretches(source)
    if vector is None:
        fast = np.sqrt(np.mean(fast_noise(readings) ** 2, axis=1))
        spread = readings.std(axis=0).mean(axis=1)
        # Of the readings' spread, which attitudes that jump would pass for noise; 1000 nT in the Earth's field.
        vector = np.minimum(fast, np.maximum(0.02 * spread, LEAST_SPREAD_T))
    if needs_scalar and len(reference) > 3:
        scalar = float(fast_noise(reference[:, None])[0])
    return array.with_noise(vector, scalar), estimated


def _stretches(source: SampleSource) -> tuple[FloatArray, FloatArray]:
    """Return readings (n, K, 3) and the scalar readings there are, of blocks spread over the recording."""
    stride = -(-source.sample_count // SKETCH)
    chosen = [block for index, block in enumerate(source.blocks()) if index % stride == 0]
    scalar = np.concatenate([block.scalar_T for block in chosen if block.scalar_T is not None] or [np.empty(0)])
    return np.concatenate([block.readings_T for block in chosen]), scalar[np.isfinite(scalar)]


def fast_noise(values: FloatArray) -> FloatArray:
    """Return the robust standard deviation of the white noise along the first axis."""
    difference = np.diff(values, n=min(3, len(values) - 1), axis=0)
    # np.sqrt(20.0): of the weights 1, 3, 3, 1: by so much white noise grows in third differences.
    spread = noise_deviation(difference, axis=0) / np.sqrt(20.0)
    return np.asarray(np.maximum(spread, LEAST_SPREAD_T))


COSINES = 4
"""Number of cosines: with more the estimate is more certain, but too small where the residual drifts slowly.

Beside what is unknown in real recordings intervals cover 94 % with four and 91 % with eight (benchmarks/intervals.py).
"""

BLOCKS = 4 * COSINES
"""Of equal length, in which samples are summed: eight in a period of the fastest cosine."""


def slow_cosines(count: int = COSINES) -> FloatArray:
    """Return the cosines (BLOCKS, count) of 1, 2, … half periods in all blocks, of unit mean square."""
    phase = np.pi * (np.arange(BLOCKS) + 0.5) / BLOCKS
    return np.asarray(np.sqrt(2) * np.cos(np.outer(phase, np.arange(1, count + 1))))


@dataclass(frozen=True)
class SlowSums:
    """What the slow sums of a channel's scores show.

    Parameters
    ----------
    factor : float
        Their variance over that of white noise; 1 where that makes as much by chance.
    is_growing : bool
        Whether the slowest vary more than the others, so that the noise lasts as long as the recording: no sum tells
        how much its mean varies.
    """

    factor: float = 1.0
    is_growing: bool = False

    @classmethod
    def of(cls, information: FloatArray, score: FloatArray) -> "SlowSums":
        """Return what a channel shows.

        Parameters
        ----------
        information : (M, Q, Q) array
            Of the channel in blocks of time, in units of which that of both channels in all blocks is one.
        score : (M, Q) array
            Of the channel in these blocks.
        """
        part, directions = np.linalg.eigh(information.sum(axis=0))
        # Part of the information on a direction from which it is one of a channel: each channel tells what the other
        # does not, so that it is all or nothing but for rounding.
        own = 0.5
        white = directions[:, part > own] / np.sqrt(part[part > own])
        information, score = white.T @ information @ white, score @ white
        # At the best errors the channels' sums balance each other, and a prior: what is left is no sign of slowness.
        score = score - score.sum(axis=0) @ information
        cosines = slow_cosines(BLOCKS - 1)
        slow, every = (_ratio(information, score, some) for some in (cosines[:, :COSINES], cosines))
        # Standard deviations of a normal law beyond which white noise of the stated size is once in a thousand
        # recordings: as often standard errors are widened without need.
        beyond = 3.09
        if max(_deviation(slow), _deviation(every)) <= beyond:
            return cls()
        # What lasts for a few samples only shows in fast cosines too, of which there are more.
        fast = _ratio(information, score, cosines[:, COSINES:])
        return cls(max(1.0, slow[0], every[0]), _deviation(slow, fast) > beyond)


def _ratio(information: FloatArray, score: FloatArray, cosines: FloatArray) -> tuple[float, float]:
    """Return the variance of sums over that of white noise, and the variance of its cube root where the noise is white.

    A sum of squares of unequal variances is nearly a multiple of a χ² (Satterthwaite 1946), the cube root of which is
    nearly normal (Wilson and Hilferty 1931).
    """
    energy = float(np.sum((cosines.T @ score) ** 2))
    taken = np.tensordot(cosines.T, information, 1)
    first, second = np.triu_indices(len(taken))
    covariance = np.tensordot((cosines[:, first] * cosines[:, second]).T, information, 1) - taken[first] @ taken[second]
    is_same = first == second
    squares = float(np.sum(covariance**2, axis=(1, 2)) @ np.where(is_same, 1.0, 2.0))
    expected = float(np.trace(covariance[is_same], axis1=1, axis2=2).sum())
    return (energy / expected, 2 / 9 * squares / expected**2) if expected > 0 else (1.0, 1.0)


def _deviation(ratio: tuple[float, float], other: tuple[float, float] = (1.0, 0.0)) -> float:
    """Return by how many standard deviations a ratio exceeds that of other sums of the same noise, or white noise."""
    (value, variance), (other_value, other_variance) = ratio, other
    root = np.cbrt(value / other_value)
    return float((root * (1 - other_variance) - 1 + variance) / np.sqrt(root**2 * other_variance + variance))


class VarianceFactors(NamedTuple):
    """Variance of the scores of each channel over that which white noise of the stated size gives them.

    Parameters
    ----------
    differential : float
        Of the channels between the sensors; 1 or more.
    common_mode : float
        Of the intensity against its reference; 1 or more.
    """

    differential: float = 1.0
    common_mode: float = 1.0

    def at_least(self, others: "VarianceFactors") -> "VarianceFactors":
        """Return the larger of each two."""
        return VarianceFactors(*map(max, self, others))

    def times(self, multiple: float) -> "VarianceFactors":
        """Return a multiple of both."""
        return VarianceFactors(multiple * self.differential, multiple * self.common_mode)

    def exceed(self, others: "VarianceFactors", part: float) -> bool:
        """Whether one of them is larger than the same of others by more than a part of that."""
        return any(own > (1 + part) * other for own, other in zip(self, others, strict=True))


WHITE = VarianceFactors()
"""Of white noise of the stated size."""
