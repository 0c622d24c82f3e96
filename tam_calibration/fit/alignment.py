"""The alignment of sensors that are orthogonal already: Procrustes analysis, and the linear regression before it.

Every function takes any number of leading axes and treats each of them apart.
"""

import numpy as np
from numpy.linalg import inv

from tam_calibration.fit.handedness import require_one_hand
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees

_LARGEST_TURN = from_degrees(80.0)
"""Of a sensor whose angle is found by its sine, radians: noise counts six times there, and without bound at 90°."""


def field_products(joint: FloatArray, unmix: FloatArray, center: FloatArray) -> FloatArray:
    """Return the sums of the outer products of the restored fields.

    Parameters
    ----------
    joint : (S, 3K+1, 3K+1) array
        Moments of all readings, and 1.
    unmix : (S, K, 3, 3) array
        From unbiased readings to the field in each sensor's own frame.
    center : (S, K, 3) array
        Biases.

    Returns
    -------
    (S, K, K, 3, 3) array
        At k, l the sum of b_k b_lᵀ.
    """
    sets, sensors = center.shape[:2]
    restore = np.zeros((sets, sensors, 3, 3 * sensors + 1))
    for sensor in range(sensors):
        restore[:, sensor, :, 3 * sensor : 3 * sensor + 3] = unmix[:, sensor]
    restore[..., -1:] = -unmix @ center[..., None]
    restore = restore.reshape(sets, 3 * sensors, -1)
    products: FloatArray = restore @ joint @ np.swapaxes(restore, 1, 2)
    return np.swapaxes(products.reshape(sets, sensors, 3, sensors, 3), 2, 3)


def procrustes(cross: FloatArray) -> FloatArray:
    """Return the rotations Λ that turn a reference into each sensor's field.

    Parameters
    ----------
    cross : (..., K, 3, 3) array
        Sums of b_k bᵀ, b the reference.

    Returns
    -------
    (..., K, 3, 3) array
        Minimising the sum of |b_k - Λ_k b|² over rotations (Chi 2017 eq. 16, the other way round).

    Raises
    ------
    InputError
        When sensors are mirror images of others; it has their numbers.
    """
    left, _, right = np.linalg.svd(cross)
    rotation: FloatArray = left @ right
    require_one_hand(rotation)
    return rotation


def rotation_by_regression(regression: FloatArray) -> FloatArray:
    """Return the rotations Λ of the sensors from the regression of a reference on their fields, angle by angle.

    The z row of b = V b_k gives two angles, the y row the third: what V says beside that is not used. Li 2018a compares
    itself with this alignment of Yin 2014, and its Table 2 is met by it.

    Parameters
    ----------
    regression : (..., K, 3, 3) array
        V of each sensor.

    Raises
    ------
    InputError
        When a sensor is turned by more than 80° about y or z: from 90° on the arc sine is wrong, and near it noise is.
        When sensors are mirror images of others.
    """
    require_one_hand(regression)
    beyond = (regression[..., 0, 0] < np.cos(_LARGEST_TURN)).reshape(-1, regression.shape[-3]).any(axis=0)
    if beyond.any():
        raise InputError(
            f"sensor {np.argmax(beyond) + 1} is turned by more than 80° against the reference, "
            "beyond what a linear alignment finds: use the method maximum_likelihood"
        )
    beta = -np.arcsin(np.clip(regression[..., 2, 0], -1, 1))
    alpha = np.arctan2(regression[..., 2, 1], regression[..., 2, 2])
    gamma = np.arcsin(np.clip(regression[..., 1, 0] / np.cos(beta), -1, 1))
    angles = np.stack([alpha, beta, gamma], axis=-1).reshape(-1, 3)
    zero = np.zeros_like(angles)
    rotation: FloatArray = SensorErrors(zero + 1, zero, zero, angles).rotation
    return rotation.reshape(regression.shape)


def regression_on_first(products: FloatArray) -> FloatArray:
    """Return the regressions V (S, K, 3, 3) of sensor 1's field on each sensor's, from ``field_products``."""
    own = np.moveaxis(np.diagonal(products, axis1=1, axis2=2), -1, 1)
    regression: FloatArray = products[:, 0] @ inv(own)
    return regression


def into_frame_of_first(matrix: FloatArray) -> FloatArray:
    """Turn the common frame of matrices D Λ (S, K, 3, 3), all of one hand, into the orthogonal frame of sensor 1."""
    require_one_hand(matrix)
    first = SensorErrors.from_matrix(matrix[:, 0], np.zeros((len(matrix), 3))).rotation
    turned: FloatArray = matrix @ np.swapaxes(first, 1, 2)[:, None]
    return turned
