"""How far the errors of new sensors may be from none: what a data sheet and a mounting tell before any calibration."""

from dataclasses import dataclass, fields

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, from_degrees

_LARGEST = {
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
            value, largest = getattr(self, each.name), _LARGEST[each.name]
            if not 0 < value <= largest:
                raise InputError(
                    f"the tolerance of {each.name} is {value:g}, and lies above 0 and within {largest:g} (SI): check "
                    "units"
                )

    def variances(self) -> FloatArray:
        """Return the (12,) variances of a sensor's errors, in the order of ``PARAMETER_NAMES``, SI."""
        return np.repeat([getattr(self, each.name) ** 2 for each in fields(self)], 3)
