"""How a recorded attitude is turned against the frame of a field that is constant in the world."""

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray


def find_turn(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return the rotation X with which the fields to_world X field are nearest to one vector w.

    Parameters
    ----------
    field : (N, 3) array
        Uniform field b in a frame that is fixed to the array, in a unit in which it is of order one.
    to_world : (N, 3, 3) array
        Recorded attitude Q of each sample: rotation matrix from the array frame to the world.

    Returns
    -------
    (3, 3) array
        From the frame of the field to the one whose attitude was recorded.

    Raises
    ------
    InputError
        When the array was not turned about two axes.
    """
    turns = _still_turns(field, to_world)
    if turns.shape[1] != 1:
        raise InputError("the attitude does not determine the frame: turn the array about two axes at least")
    return _nearest_rotation(turns.reshape(3, 3))


def likely_turn(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return such a rotation also where the array was hardly turned: of all that agree, one near to no turn.

    Parameters
    ----------
    field, to_world : array
        As of ``find_turn``.
    """
    turns = _still_turns(field, to_world)
    return _nearest_rotation((turns if turns.shape[1] == 1 else turns @ (turns.T @ np.eye(3).ravel())).reshape(3, 3))


def _still_turns(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return the (9, M) turns X with which the field is constant in the world, M ≥ 1, the best first.

    The sum of |X b - Qᵀ w|² is quadratic in X and w together; w is eliminated, and the best X of unit norm is an
    eigenvector.
    """
    mixed = np.einsum("naj,ni->jia", to_world, field).reshape(9, 3)
    residuals = np.kron(np.eye(3), field.T @ field) - mixed @ mixed.T / len(field)
    values, vectors = np.linalg.eigh(residuals)
    # How far the second best turn must be from the field standing still, as part of the field's square.
    return vectors[:, : max(1, int(np.searchsorted(values, 1e-3 * len(field))))]


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    left, _, right = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    return np.asarray(left @ right)


def aligned(attitude: FloatArray, field: FloatArray) -> FloatArray:
    """Return attitudes that agree with the field, which is almost constant in the world.

    Parameters
    ----------
    attitude : (N, 4) array
        As recorded: turned against the array by a fixed angle, and in error from sample to sample.
    field : (N, 3) array
        At the centre in the array frame, in any unit.

    Returns
    -------
    (N, 4) array
        Without the fixed turn. Of each sample's error only the part about the field remains, which cannot be seen.
    """
    from scipy.spatial.transform import Rotation

    recorded = Rotation.from_quat(attitude)
    field = field / norm(field, axis=1, keepdims=True)
    to_world = recorded * Rotation.from_matrix(likely_turn(field, recorded.as_matrix()))
    seen = to_world.apply(field)
    back = turns_between(seen, seen.mean(axis=0))
    return np.asarray((Rotation.from_rotvec(back) * to_world).as_quat())


def turns_between(seen: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the shortest rotation vectors (N, 3) that turn vectors (N, 3) to the direction of one (3,) or of each."""
    axis = np.cross(seen, direction)
    sine, cosine = norm(axis, axis=1), np.sum(seen * direction, axis=1)
    return np.asarray(axis * (np.arctan2(sine, cosine) / np.maximum(sine, np.finfo(float).tiny))[:, None])
