"""Whether what is summed over time is correlated from sample to sample, and by how much that increases variances.

Where the samples are stationary, a sum weighted by a slow cosine has the variance of the sum itself, whatever the
correlation is, as long as it ends within a fraction of the recording (Lazarus, Lewis, Stock and Watson, HAR inference:
recommendations for practice, J. Bus. Econ. Stat. 36, 2018, p. 541: equally weighted cosines). The weighted sums of
scores are compared with the variance that white noise of the stated size gives them, all parameters together: each
alone would have too few degrees of freedom.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tam_calibration.model.units import FloatArray

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

    def is_near(self, others: "VarianceFactors", part: float) -> bool:
        """Whether both differ from the same of others by no more than a part of those."""
        return all(abs(own - other) <= part * other for own, other in zip(self, others, strict=True))

    def exceed(self, others: "VarianceFactors", part: float) -> bool:
        """Whether one of them is larger than the same of others by more than a part of that."""
        return any(own > (1 + part) * other for own, other in zip(self, others, strict=True))


WHITE = VarianceFactors()
"""Of white noise of the stated size."""
