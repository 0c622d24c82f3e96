"""What interpolation makes of the white noise of sensors that are read by clocks of their own."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.units import FloatArray

LAGS = 8
"""Samples after which nothing is left of the correlation: five readings take less at seven tenths of the rate."""

_LEAST = 0.05
"""Part of white noise that is left at any frequency, at least: between readings at even steps it is 0.08."""


@dataclass(frozen=True, eq=False)
class InterpolatedNoise:
    """The correlation of the noise of K sensors from sample to sample that interpolation makes; its size is kept.

    Parameters
    ----------
    correlation : (K, LAGS) array
        Of samples that lie so many apart.
    readings_per_sample : (K,) array
        Number of readings of a sensor from one sample to the next.
    """

    correlation: FloatArray
    readings_per_sample: FloatArray

    def spectrum(self, frequency: FloatArray) -> FloatArray:
        """Return the power (K, F) of white noise of variance one at frequencies (F,), cycles a sample."""
        turns = np.cos(2 * np.pi * np.outer(np.arange(1, LAGS + 1), frequency))
        power: FloatArray = np.maximum(1 + 2 * self.correlation @ turns, _LEAST)
        return power
