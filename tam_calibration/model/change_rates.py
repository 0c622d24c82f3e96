"""How fast the errors of sensors change: what a calibration of yesterday is worth today."""

from dataclasses import dataclass, fields

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

DAY_S = 86_400.0

_LARGEST = {"scale_factor": 0.1, "non_orthogonality": 0.1, "bias": 1e-4, "misalignment": 0.1}
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
            value, largest = getattr(self, each.name), _LARGEST[each.name.partition("_per_")[0]]
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
        kinds = ("scale_factor", "non_orthogonality", "bias", "misalignment")
        by_day = np.array([getattr(self, f"{kind}_per_day") for kind in kinds])
        by_kelvin = np.array([getattr(self, f"{kind}_per_K") for kind in kinds])
        return np.repeat(by_day**2 * abs(elapsed_s) / DAY_S + (by_kelvin * warming_K) ** 2, 3)
