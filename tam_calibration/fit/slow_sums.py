"""What sums of scores over time show of the noise: whether it varies more, or longer, than white noise.

Their sums weighted by slow cosines (``core.slow_cosines``) are compared with the variance that white noise of the
stated size gives them, all parameters together: each alone would have too few degrees of freedom.
"""

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from tam_calibration.core.slow_cosines import BLOCKS, COSINES, slow_cosines
from tam_calibration.model.units import FloatArray

_BEYOND = 3.09
"""Standard deviations of a normal law beyond which white noise of the stated size is once in a thousand recordings: as
often standard errors are widened without need."""

_OWN = 0.5
"""Part of the information on a direction from which it is one of a channel: each channel tells what the other does not,
so that it is all or nothing but for rounding."""


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
        white = directions[:, part > _OWN] / np.sqrt(part[part > _OWN])
        information, score = white.T @ information @ white, score @ white
        # At the best errors the channels' sums balance each other, and a prior: what is left is no sign of slowness.
        score = score - score.sum(axis=0) @ information
        cosines = slow_cosines(BLOCKS - 1)
        # What lasts for a few samples only shows in fast cosines too, of which there are more.
        slow, every, fast = (
            _Ratio.of(information, score, some) for some in (cosines[:, :COSINES], cosines, cosines[:, COSINES:])
        )
        if max(slow.deviation, every.deviation) <= _BEYOND:
            return cls()
        return cls(max(1.0, slow.value, every.value), slow.deviation_from(fast) > _BEYOND)


@dataclass(frozen=True)
class _Ratio:
    """Variance of sums over that of white noise.

    A sum of squares of unequal variances is nearly a multiple of a χ² (Satterthwaite 1946), the cube root of which is
    nearly normal (Wilson and Hilferty 1931), with a variance that is stated for white noise.
    """

    value: float
    variance: float

    @classmethod
    def of(cls, information: FloatArray, score: FloatArray, cosines: FloatArray) -> "_Ratio":
        energy = float(np.sum((cosines.T @ score) ** 2))
        taken = np.einsum("bc,bpq->cpq", cosines, information)
        expected = squares = 0.0
        for first, second in combinations_with_replacement(range(len(taken)), 2):
            weights = cosines[:, first] * cosines[:, second]
            covariance = np.tensordot(weights, information, 1) - taken[first] @ taken[second]
            squares += (1 if first == second else 2) * float(np.sum(covariance**2))
            expected += float(np.trace(covariance)) if first == second else 0.0
        if expected <= 0:
            return cls(1.0, 1.0)
        return cls(energy / expected, 2 / 9 * squares / expected**2)

    @property
    def deviation(self) -> float:
        """From white noise, in standard deviations."""
        return self.deviation_from(_Ratio(1.0, 0.0))

    def deviation_from(self, other: "_Ratio") -> float:
        """Return by how many standard deviations it exceeds that of other sums of the same noise."""
        root = np.cbrt(self.value / other.value)
        return float(
            (root * (1 - other.variance) - 1 + self.variance) / np.sqrt(root**2 * other.variance + self.variance)
        )
