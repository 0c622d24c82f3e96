"""How the array stands in the world, from its attitude."""

import numpy as np

from tam_calibration.effects.situation import Situation
from tam_calibration.units import FloatArray

LEAST_TURN = 0.1
"""Radians, root of the mean square, by which the array or the vertical in it must turn: noise of attitudes is less."""


def to_world(situation: Situation) -> FloatArray:
    """Return the (N, 3, 3) matrices that turn vectors of the array frame into the world's."""
    from scipy.spatial.transform import Rotation

    assert situation.attitude is not None
    matrices: FloatArray = Rotation.from_quat(situation.attitude).as_matrix()
    return matrices


def upwards(situation: Situation) -> FloatArray:
    """Return the (N, 3) direction upwards, against gravity, in the array frame."""
    return to_world(situation)[:, 2]


def turn_spread(situation: Situation) -> float:
    """Return the root mean square angle, radians, by which the attitudes differ from their mean."""
    quaternion = situation.attitude
    assert quaternion is not None
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    # The largest eigenvalue is the mean square cosine of half the angles.
    missing = 1 - np.linalg.eigvalsh(unit.T @ unit / len(unit))[-1]
    return float(2 * np.arcsin(np.sqrt(np.clip(missing, 0, 1))))
