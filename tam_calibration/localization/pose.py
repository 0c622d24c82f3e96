"""Sources as poses and ellipsoids: what generic tools show of a position and a moment with their covariances."""

import numpy as np

from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.model.units import FloatArray

ELLIPSOID_PROBABILITY = 0.95
"""With which a source is within its ellipsoid: what is usual for maps."""

ANY_ANGLE_VARIANCE = np.pi**2 / 3
"""Variance of an angle that is anything from -π to π, rad²."""


def ellipsoid(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ellipsoid that holds a normally distributed position with ``ELLIPSOID_PROBABILITY``.

    Parameters
    ----------
    covariance : (3, 3) array
        Of the position, m².

    Returns
    -------
    semi_axes : (3,) array
        Rising, metres.
    rotation : (4,) array
        Quaternion x, y, z, w that turns the axes x, y and z to the semi-axes.
    """
    from scipy.spatial.transform import Rotation
    from scipy.special import chdtri

    variances, vectors = np.linalg.eigh(covariance)
    vectors[:, 2] *= np.sign(np.linalg.det(vectors))  # else it would be a reflection
    semi_axes: FloatArray = np.sqrt(chdtri(3, 1 - ELLIPSOID_PROBABILITY) * np.maximum(variances, 0.0))
    return semi_axes, Rotation.from_matrix(vectors).as_quat()


def pose_rows(solutions: EulerSolutions) -> FloatArray:
    """Return sources as the numbers of ``geometry_msgs/PoseWithCovariance``.

    The pose's axis x points along the moment; any angle about it is as good as another. Where there is no moment any
    orientation is. Between position and orientation the covariance is zero: it is not worked out.

    Parameters
    ----------
    solutions : EulerSolutions
        Of N samples.

    Returns
    -------
    (N, 43) array
        Position in metres, quaternion x, y, z, w, and the (6, 6) covariance of position and rotations about the fixed
        axes x, y and z, row by row, m² and rad².
    """
    count = len(solutions.status)
    covariance = np.zeros((count, 6, 6))
    covariance[:, :3, :3] = solutions.position_covariance_m2
    covariance[:, 3:, 3:] = ANY_ANGLE_VARIANCE * np.eye(3)
    rotation = np.tile([0.0, 0.0, 0.0, 1.0], (count, 1))
    length = np.linalg.norm(solutions.moment_Am2, axis=1)
    known = np.flatnonzero(length > 0)
    unit = solutions.moment_Am2[known] / length[known, None]
    rotation[known] = _from_x_to(unit)
    across = np.cross(unit[:, None], np.eye(3)).transpose(0, 2, 1) / length[known, None, None]
    tilt = across @ solutions.moment_covariance_A2m4[known] @ across.transpose(0, 2, 1)
    covariance[known, 3:, 3:] = tilt + ANY_ANGLE_VARIANCE * unit[:, :, None] * unit[:, None]
    return np.hstack([solutions.position_m, rotation, covariance.reshape(count, 36)])


def _from_x_to(unit: FloatArray) -> FloatArray:
    """Return the quaternions (n, 4) of the shortest rotations from the axis x to unit vectors (n, 3)."""
    x, y, z = unit.T
    quaternion = np.column_stack([np.zeros_like(x), -z, y, 1 + x])
    length = np.linalg.norm(quaternion, axis=1, keepdims=True)
    backward = np.array([0.0, 0.0, 1.0, 0.0])
    return np.where(length > 1e-6, quaternion / np.maximum(length, 1e-6), backward)
