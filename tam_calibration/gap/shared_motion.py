"""How much of the motion that the first sensor sees the others see as well."""

import numpy as np

from tam_calibration.effects.grades import MOST
from tam_calibration.units import FloatArray

_SURE = 15.0
"""Over the root of the number of samples: a correlation that is sure.

White noise makes one to two of it, slow noise three times as much.
"""

_WILD = 8.0
"""Times the median distance from the median, from which a reading is a spike; a motion hardly goes so far."""


def canonical_correlations(readings_T: FloatArray) -> FloatArray:
    """Return the canonical correlations (K, 3), the largest first, of sensors' readings (N, K, 3) with the first's.

    By the singular values between orthonormal bases of both (Björck and Golub 1973). Spikes do not count.
    """
    centered = readings_T - np.median(readings_T, axis=0)
    size = _WILD * np.median(np.abs(centered), axis=0)
    clipped = np.clip(centered, np.where(size > 0, -size, -np.inf), np.where(size > 0, size, np.inf))
    centered = np.swapaxes(clipped - clipped.mean(axis=0), 0, 1)
    basis = np.linalg.svd(centered, full_matrices=False)[0]
    correlations: FloatArray = np.linalg.svd(np.swapaxes(basis, 1, 2) @ basis[0], compute_uv=False)
    return correlations


def sure_correlation(sample_count: int) -> float:
    """Return the correlation from which noise of so many samples is not its cause."""
    return float(min(_SURE / np.sqrt(sample_count), MOST))
