"""Noise with outliers, by a multivariate Student-t distribution of some channels: how much each sample counts.

An M-estimate solves Σ w s = 0, with s the scores of the samples and w their weights. Its variance is the sandwich of
the mean square of the weighted channels and the square of their mean derivative.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.model.units import FloatArray

_DEGREES_OF_FREEDOM = 6.0
"""With four sensors the standard errors are 1.04 times the bound's without outliers; with 4 they would be 1.05."""

_MOST_STEPS = 200
"""Of the scale of the noise, each of which leaves a constant part of the way."""

_SMALLEST_SQUARE = 1e-4
"""Of the scale of the noise: below a hundredth of what is stated lies only rounding."""


@dataclass(frozen=True, eq=False)
class StudentNoise:
    """The noise of samples whose whitened channels are given.

    Parameters
    ----------
    energy : (N,) array
        Sum of the squares of each sample's whitened channels.
    channels : (N,) array
        Number of channels of each sample.
    square : float
        Square of the scale of the noise, in units of the stated one.
    """

    energy: FloatArray
    channels: FloatArray
    square: float

    @classmethod
    def of(cls, energy: FloatArray, channels: FloatArray) -> "StudentNoise":
        """Return the noise whose scale is the most likely one."""
        # One sensor tells nothing where the scalar is missing.
        known = channels > 0
        if not known.any():
            return cls(energy, channels, 1.0)
        noise = cls(energy, channels, max(float(np.median(energy[known] / channels[known])), _SMALLEST_SQUARE))
        for _ in range(_MOST_STEPS):
            previous, square = noise.square, noise.spread_of(1)
            noise = cls(energy, channels, max(square, _SMALLEST_SQUARE))
            if square <= _SMALLEST_SQUARE or abs(square - previous) <= 1e-10 * square:
                break
        return noise

    @cached_property
    def weights(self) -> FloatArray:
        """(N,) weights of samples: about one for noise, small for outliers."""
        return (_DEGREES_OF_FREEDOM + self.channels) / (_DEGREES_OF_FREEDOM + self.energy / self.square)

    def spread_of(self, power: int) -> float:
        """Return the mean, over the channels, of the weights to a power times the squares; 1 where there is none."""
        return float(np.sum(self.weights**power * self.energy) / self.channels.sum()) if self.channels.any() else 1.0

    @property
    def variance_factor(self) -> float:
        """Variance of the weighted estimate over that of the inverse information with the stated noise."""
        if not self.channels.any():
            return 1.0
        slope = -self.weights / (_DEGREES_OF_FREEDOM * self.square + self.energy)
        derivative = np.sum(self.weights * self.channels + 2 * slope * self.energy) / self.channels.sum()
        return float(self.spread_of(2) / derivative**2)
