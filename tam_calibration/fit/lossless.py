"""The lossless scalar calibration of Wu 2025 in three steps, from moments of one pass over the data.

Step 1 finds each sensor's bias as the centre of an ellipsoid, step 2 its scale factors and non-orthogonality against
the scalar reference, step 3 the misalignment between sensors by Procrustes analysis.
"""

import numpy as np
from numpy.linalg import inv

from tam_calibration.array import Array
from tam_calibration.calibration import Calibration
from tam_calibration.errors import SensorErrors
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, procrustes
from tam_calibration.fit.moments import Moments, finish, gather
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray


def lossless(recording: Recording, array: Array, *, as_published: bool = False) -> Calibration:
    """Fit the errors of the sensors by Wu 2025.

    Parameters
    ----------
    recording : Recording
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise.
    as_published : bool
        Step 1 as printed: a constant intensity, and sequential quadratic programming on eq. 12. Otherwise its
        right-hand side follows the scalar reading, and the linear solution, which is the same minimum, is kept.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor is left-handed.
    """
    method = "lossless (as published)" if as_published else "lossless"
    moments = gather(recording, method)
    center = _published_center(moments) if as_published else ellipsoid.center_of(moments.quartic)
    return finish(method, recording, array, moments.data, _matrix_about(moments, center), center)


def estimate(recording: Recording) -> SensorErrors:
    """Return the errors alone, without covariance and quality: the same numbers in a tenth of the time.

    Parameters
    ----------
    recording : Recording
        Samples in a uniform field, with a scalar reference.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor is left-handed.
    """
    moments = gather(recording, "lossless", groups=1)
    center = ellipsoid.center_of(moments.quartic)
    bias_T = moments.data.origin_T + moments.data.radius_T * center[0]
    return SensorErrors.from_matrix(_matrix_about(moments, center)[0], bias_T)


def _matrix_about(moments: Moments, center: FloatArray) -> FloatArray:
    """Return the matrices D Λ (S, K, 3, 3) of steps 2 and 3, about the centres (S, K, 3) of step 1."""
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    rotation = procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    matrix: FloatArray = inv(unmix) @ rotation
    return matrix


def _published_center(moments: Moments) -> FloatArray:
    """Return the centres of step 1 as printed: origin at zero reading, intensity constant, SLSQP on eq. 12."""
    quartic = moments.quartic
    origin = -moments.data.origin_T / moments.data.radius_T
    from_zero = ellipsoid.move_origin(quartic, np.broadcast_to(origin, (len(quartic), *origin.shape)))
    found = np.empty((*quartic.shape[:2], 3))
    for index in np.ndindex(*quartic.shape[:2]):
        found[index] = _sequential_quadratic_programming(from_zero[index])
    centers: FloatArray = found + origin
    return centers


def _sequential_quadratic_programming(moments: FloatArray) -> FloatArray:
    from scipy.optimize import minimize

    unknowns = np.linalg.solve(moments[:9, :9], moments[:9, 9])
    center = np.linalg.solve(ellipsoid.symmetric(unknowns[:6]), -unknowns[6:] / 2)
    # The linear form yields A/(1 - oᵀAo).
    shape = unknowns[:6] / (1 + center @ ellipsoid.symmetric(unknowns[:6]) @ center)
    start = np.concatenate([shape, center])

    def objective(u: FloatArray) -> tuple[float, FloatArray]:
        matrix = ellipsoid.symmetric(u[:6])
        x, y, z = u[6:]
        coefficients = np.concatenate([u[:6], -2 * matrix @ u[6:], [u[6:] @ matrix @ u[6:] - 1]])
        derivative = np.zeros((10, 9))
        derivative[:6, :6] = np.eye(6)
        by_shape = np.array([[x, 0, 0, y, z, 0], [0, y, 0, x, 0, z], [0, 0, z, 0, x, y]])
        derivative[6:9, :6], derivative[6:9, 6:] = -2 * by_shape, -2 * matrix
        derivative[9, :6] = [x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z]
        derivative[9, 6:] = 2 * matrix @ u[6:]
        weighted = moments[:10, :10] @ coefficients / moments[9, 9]
        return float(coefficients @ weighted), 2 * derivative.T @ weighted

    bounds = [(value - 1, value + 1) for value in start]
    result = minimize(
        objective, start, jac=True, method="SLSQP", bounds=bounds, options={"ftol": 1e-24, "maxiter": 200}
    )
    found: FloatArray = result.x[6:]
    return found
