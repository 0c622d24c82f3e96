"""What keeps normal equations solvable in directions that the data do not tell."""

import numpy as np

from tam_calibration.units import FloatArray

_RIDGE = 1e-9
"""Part of the mean information that is added in each direction: above rounding, and below all that data tell."""


def ridged(information: FloatArray) -> FloatArray:
    """Return information matrices (..., P, P) with a ridge, too small to be seen in directions that the data tell.

    Of matrices that are zero it makes some that are not, so that what has no score gets no value.
    """
    mean = np.asarray(np.trace(information, axis1=-2, axis2=-1) / information.shape[-1])
    size = np.where(mean > 0, mean, 1.0)
    added: FloatArray = information + _RIDGE * size[..., None, None] * np.eye(information.shape[-1])
    return added
