"""The attitudes that a turntable or a vehicle can reach, and where the field then points in the array frame.

An attitude is a turn by yaw, then pitch, then roll from level and magnetic north: about z, y and x, right-handed, so
that positive yaw turns to the left, positive pitch lowers the nose and positive roll lowers the right side.
"""

from dataclasses import dataclass

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.units import FloatArray, from_degrees

_STEP = from_degrees(15.0)
"""Finer steps than this are not told apart: they hardly change the errors."""

_DISTINCT = 0.01


@dataclass(frozen=True, eq=False)
class Reach:
    """Attitudes with different directions of the field, of equal directions the one of least tilt.

    Parameters
    ----------
    angles : (C, 3) array
        Yaw from magnetic north, pitch and roll, radians.
    directions : (C, 3) array
        Unit vectors of the field in the array frame.
    """

    angles: FloatArray
    directions: FloatArray


def reach_of_turntable(steps: FloatArray, inclination: float) -> Reach:
    """Return the reach of a turntable that turns right round in steps (3,) of yaw, pitch and roll; 0 holds an axis.

    Parameters
    ----------
    steps : (3,) array
        Radians; of fine ones multiples of 15 degrees or more are taken.
    inclination : float
        Of the field, positive downwards, radians.

    Raises
    ------
    InputError
        When a step is negative or more than half a turn.
    """
    if not ((steps >= 0) & (steps <= np.pi)).all():
        raise InputError("the steps of a turntable must lie between 0 (an axis that does not turn) and 180 degrees")
    return _reach([_turn(float(step)) for step in steps], inclination)


def reach_of_vehicle(pitch_limit: float, roll_limit: float, inclination: float) -> Reach:
    """Return the reach of a vehicle that yaws right round, and pitches and rolls up to limits, radians.

    Raises
    ------
    InputError
        When the pitch limit lies outside 0 to 90 degrees or the roll limit outside 0 to 180.
    """
    if not (0 <= pitch_limit <= np.pi / 2 and 0 <= roll_limit <= np.pi):
        raise InputError("the pitch limit must lie between 0 and 90 degrees, the roll limit between 0 and 180")
    return _reach([_turn(_STEP), _swing(pitch_limit), _swing(roll_limit)], inclination)


def _turn(step: float) -> FloatArray:
    if step == 0:
        return np.zeros(1)
    step *= np.ceil(_STEP / step - 1e-9)
    angle = np.arange(0, 2 * np.pi - 1e-9, step)
    turn: FloatArray = np.where(angle > np.pi + 1e-9, angle - 2 * np.pi, angle)
    return turn


def _swing(limit: float) -> FloatArray:
    steps = max(2, int(np.ceil(limit / _STEP - 1e-9)))
    return np.linspace(-limit, limit, 2 * steps + 1)


def field_directions(angles: FloatArray, inclination: float) -> FloatArray:
    """Return the (N, 3) unit vectors of the field in the array frame at yaw, pitch and roll (N, 3), radians."""
    from scipy.spatial.transform import Rotation

    in_world = [np.cos(inclination), 0.0, -np.sin(inclination)]
    directions: FloatArray = Rotation.from_euler("ZYX", angles).inv().apply(in_world)
    return directions


def _reach(axes: list[FloatArray], inclination: float) -> Reach:
    angles = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    angles = angles[np.argsort(np.abs(angles[:, 1:]).sum(axis=1), kind="stable")]
    directions = field_directions(angles, inclination)
    _, first = np.unique(np.round(directions / _DISTINCT), axis=0, return_index=True)
    first = np.sort(first)
    return Reach(angles[first], directions[first])
