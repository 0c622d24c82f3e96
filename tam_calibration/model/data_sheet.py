"""What data sheets tell before a calibration: tolerances of new sensors, their rates of change, and a gyroscope."""

from dataclasses import astuple, dataclass, fields

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import RATE_BIAS, RATE_NOISE, RATE_SCALE
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

DAY_S = 86_400.0

_LARGEST_RATES = {"scale_factor": 0.1, "non_orthogonality": 0.1, "bias": 1e-4, "misalignment": 0.1}
"""Of a rate by the kind it is of, SI: a sensor that changes by a tenth, six degrees or 100 µT a day is broken."""


@dataclass(frozen=True)
class ChangeRates:
    """Standard deviations of the changes of a sensor's errors, of each of the twelve independently.

    By the day they change as a random walk does: in four days by twice as much as in one. With the temperature they
    change in proportion to its difference.

    The defaults are those of fluxgates for surveys. Their data sheets promise an offset within 0.1 nT and a scale
    factor within 20 ppm of each kelvin; magnetically and mechanically quiet ones in observatories keep to a few
    nanotesla and seconds of arc in a year, vehicles that are handled are worse: half a nanotesla, five ppm and a
    thousandth of a degree in a day.

    Parameters
    ----------
    scale_factor_per_day, scale_factor_per_K : float
        Of each scale factor.
    non_orthogonality_per_day, non_orthogonality_per_K : float
        Of each angle between the axes of a sensor, radians.
    bias_per_day, bias_per_K : float
        Of each axis, tesla.
    misalignment_per_day, misalignment_per_K : float
        Of each angle of a sensor against the array, radians.

    Raises
    ------
    InputError
        When a rate is negative, not finite or beyond what a working sensor does.
    """

    scale_factor_per_day: float = 5e-6
    scale_factor_per_K: float = 20e-6
    non_orthogonality_per_day: float = from_degrees(0.0005)
    non_orthogonality_per_K: float = from_degrees(0.0002)
    bias_per_day: float = from_nanotesla(0.5)
    bias_per_K: float = from_nanotesla(0.1)
    misalignment_per_day: float = from_degrees(0.001)
    misalignment_per_K: float = from_degrees(0.0002)

    def __post_init__(self) -> None:
        """Check the values."""
        for each in fields(self):
            value, largest = getattr(self, each.name), _LARGEST_RATES[each.name.partition("_per_")[0]]
            if not 0 <= value <= largest:
                raise InputError(
                    f"the rate of change {each.name} is {value:g}, and lies within 0 to {largest:g} (SI): check units"
                )

    def variances(self, elapsed_s: float, warming_K: float) -> FloatArray:
        """Return the (12,) variances of the changes of a sensor's errors, in the order of ``PARAMETER_NAMES``, SI.

        Parameters
        ----------
        elapsed_s : float
            Time that has passed, to either side, seconds.
        warming_K : float
            Difference of the temperatures, kelvin.
        """
        by_day, by_kelvin = np.reshape(astuple(self), (4, 2)).T
        return np.repeat(by_day**2 * abs(elapsed_s) / DAY_S + (by_kelvin * warming_K) ** 2, 3)


LARGEST_TOLERANCES = {
    "scale_factor": 0.2,
    "non_orthogonality": from_degrees(15.0),
    "bias_T": 2e-3,
    "misalignment": from_degrees(15.0),
}
"""Of a tolerance by the kind of error, SI: chips keep to more than half of it, and no scale factor within five of these
deviations is negative."""


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations of the errors of a sensor about none, of each of the twelve independently.

    Parameters
    ----------
    scale_factor : float
        Of each scale factor about 1.
    non_orthogonality : float
        Of each angle between the axes of a sensor, radians.
    bias_T : float
        Of each axis, tesla; on a vehicle with what its iron adds.
    misalignment : float
        Of each angle of a sensor against the array, radians.

    Raises
    ------
    InputError
        When one is not positive, not finite or beyond what a working sensor has.
    """

    scale_factor: float
    non_orthogonality: float
    bias_T: float
    misalignment: float

    def __post_init__(self) -> None:
        """Check the values."""
        for each in fields(self):
            value, largest = getattr(self, each.name), LARGEST_TOLERANCES[each.name]
            if not 0 < value <= largest:
                raise InputError(
                    f"the tolerance of {each.name} is {value:g}, and lies above 0 and within {largest:g} (SI): check "
                    "units"
                )

    def variances(self) -> FloatArray:
        """Return the (12,) variances of a sensor's errors, in the order of ``PARAMETER_NAMES``, SI."""
        return np.repeat(np.square(astuple(self)), 3)


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
