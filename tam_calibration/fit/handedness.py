"""Which sensors a fit finds to be mirror images of the others: their numbers, by majority.

A fit sees the handedness of sensors only against each other or against a reference that is made of them: that sensor 2
is a mirror image of sensor 1 is the same finding as that sensor 1 is one of sensor 2. The fewer are named first.
"""

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensors_in_words import numbered
from tam_calibration.model.units import FloatArray, IntArray


def require_one_hand(matrix: FloatArray) -> None:
    """Check that all sensors have the same handedness.

    Parameters
    ----------
    matrix : (..., K, 3, 3) array
        Of each sensor, from one common frame to its axes; any of the leading axes may show the mirror image.

    Raises
    ------
    InputError
        When sensors are mirror images of others, or all of the reference; it has their numbers.
    """
    is_mirrored = (np.linalg.det(matrix) < 0).reshape(-1, matrix.shape[-3]).any(axis=0)
    if is_mirrored.any():
        raise InputError(f"{mirror_images(np.where(is_mirrored, -1, 1))}: check the order and signs of the axes")


def mirror_images(hands: IntArray) -> str:
    """Return in words which sensors are mirror images of which, the fewer of them first.

    Parameters
    ----------
    hands : (K,) array
        1 or -1 for the two kinds, at least one of them -1; 0 where it cannot be told.
    """
    mirrored, others = (np.flatnonzero(hands == hand) for hand in (-1, 1))
    if not len(others):
        return f"{numbered(mirrored + 1)} {_are_mirror_images(mirrored)} of the reference"
    few, many = sorted((mirrored, others), key=len)
    return f"{numbered(few + 1)} {_are_mirror_images(few)} of {numbered(many + 1)}"


def _are_mirror_images(sensors: IntArray) -> str:
    return "is a mirror image" if len(sensors) == 1 else "are mirror images"
