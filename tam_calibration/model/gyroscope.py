"""What a data sheet states of a gyroscope: the density of its noise, and how far its bias may be from none."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import RATE_BIAS, RATE_NOISE, RATE_SCALE
from tam_calibration.model.units import FloatArray, from_degrees


@dataclass(frozen=True)
class Gyroscope:
    """A gyroscope, as the array file states it.

    Parameters
    ----------
    noise_density : float, optional
        One-sided density of its white noise, rad/s/√Hz: a sample at the rate f has the standard deviation
        density · √(f/2). None where it is to be estimated.
    bias : float
        Standard deviation of the constant bias of each axis about zero, rad/s. By default that of consumer chips, which
        data sheets bound by 3 to 10 °/s.
    scale_error : float
        Standard deviation of its scale factors, and of the angles of its axes in radians; 0 where they are true.

    Raises
    ------
    InputError
        When a value is not positive, or no gyroscope has it.
    """

    noise_density: float | None = None
    bias: float = from_degrees(5.0)
    scale_error: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if not (self.bias > 0 and (self.noise_density is None or self.noise_density > 0)):
            raise InputError("noise and bias of a gyroscope must be positive numbers")
        if self.noise_density is not None:
            RATE_NOISE.require("the noise density of the gyroscope", self.noise_density)
        RATE_SCALE.require("the scale error of the gyroscope", self.scale_error)
        RATE_BIAS.require("the bias of the gyroscope", self.bias)

    def readings(self, time_s: FloatArray, rates: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return angular velocities (N, 3) with a bias and noise, rad/s.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds, N ≥ 2.
        rates : (N, 3) array
            True angular velocities in the array frame, rad/s.
        generator : numpy.random.Generator
            Draws bias and noise.
        """
        rate_hz = (len(time_s) - 1) / float(time_s[-1] - time_s[0])
        noise = (self.noise_density or 0.0) * np.sqrt(rate_hz / 2)
        return np.asarray(rates + generator.normal(0, self.bias, 3) + generator.normal(0, noise, rates.shape))
