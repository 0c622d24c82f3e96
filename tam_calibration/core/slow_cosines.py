"""Slow cosines of time, by which sums over samples show whether what is summed is correlated from sample to sample.

Where the samples are stationary, a sum weighted by a slow cosine has the variance of the sum itself, whatever the
correlation is, as long as it ends within a fraction of the recording (Lazarus, Lewis, Stock and Watson, HAR inference:
recommendations for practice, J. Bus. Econ. Stat. 36, 2018, p. 541: equally weighted cosines).
"""

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
