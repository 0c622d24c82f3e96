"""Weights that hold outliers down: the multivariate Student-t distribution with its scale estimated.

Lange, Little & Taylor 1989, Robust statistical modeling using the t distribution.
"""

import numpy as np

from tam_calibration.units import FloatArray

DEGREES_OF_FREEDOM = 6.0
"""With four sensors the standard errors are 1.04 times the bound's without outliers; with 4 they would be 1.05."""

_MOST_STEPS = 200
_SMALLEST_SQUARE = 1e-4  # below a hundredth of the stated noise lies only rounding


def scale_square(energy: FloatArray, channels: FloatArray) -> float:
    """Return the square of the scale of the noise, in units of the stated one, by maximum likelihood.

    Parameters
    ----------
    energy : (N,) array
        Sum of the squares of each sample's whitened channels.
    channels : (N,) array
        Number of channels of each sample.
    """
    square = max(float(np.median(energy / channels)), _SMALLEST_SQUARE)
    for _ in range(_MOST_STEPS):
        previous, square = square, float(np.sum(weights(energy, channels, square) * energy) / channels.sum())
        if square <= _SMALLEST_SQUARE or abs(square - previous) <= 1e-10 * square:
            break
    return max(square, _SMALLEST_SQUARE)


def weights(energy: FloatArray, channels: FloatArray, square: float) -> FloatArray:
    """Return the (N,) weights of samples: about one for noise, small for outliers."""
    return (DEGREES_OF_FREEDOM + channels) / (DEGREES_OF_FREEDOM + energy / square)


def variance_factor(energy: FloatArray, channels: FloatArray, square: float) -> float:
    """Return the variance of the weighted estimate over that of the inverse information with the stated noise.

    The sandwich of an M-estimate: mean square of the weighted channels over the square of their mean derivative.
    """
    weight = weights(energy, channels, square)
    slope = -weight / (DEGREES_OF_FREEDOM * square + energy)
    spread = np.sum(weight**2 * energy) / channels.sum()
    derivative = np.sum(weight * channels + 2 * slope * energy) / channels.sum()
    return float(spread / derivative**2)
