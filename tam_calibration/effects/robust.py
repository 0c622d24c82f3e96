"""The scale of normal noise from medians, which the few that are far off do not move."""

import numpy as np

from tam_calibration.units import FloatArray


def noise_deviation(values: FloatArray, axis: int | None = None) -> FloatArray:
    """Return the standard deviation of normal noise whose absolute values have the same median, along an axis."""
    from scipy.special import ndtri

    deviation: FloatArray = np.median(np.abs(values), axis=axis) / ndtri(0.75)
    return deviation


def noise_energy(energy: FloatArray, freedom: int) -> float:
    """Return the variance of normal noise whose sums of so many squares have the same median as energies (N,)."""
    from scipy.special import chdtri

    return float(np.median(energy) / chdtri(freedom, 0.5))
