"""The lossless scalar calibration of Wu 2025 in three steps, from moments of one pass over the data."""

import numpy as np
from numpy.linalg import inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, procrustes
from tam_calibration.fit.estimate import Estimate, make_calibration
from tam_calibration.fit.moments import Moments, finish, gather
from tam_calibration.fit.sandwich import sandwich
from tam_calibration.fit.scale import free_scale
from tam_calibration.model.array import Array
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


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


_NAME = "lossless"


def lossless(recording: SampleSource, array: Array, *, as_published: bool = False) -> Calibration:
    """Fit the errors of the sensors by Wu 2025.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise.
    as_published : bool
        Step 1 as printed: a constant intensity, and sequential quadratic programming on eq. 12. Otherwise its
        right-hand side follows the scalar reading, and the linear solution, which is the same minimum, is kept.

    Returns
    -------
    Calibration
        With the covariance of ``sandwich``; as published that of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    if as_published:
        moments = gather(recording, _NAME)
        center = _published_center(moments)
        matrix = _matrix_about(moments, center)
        return finish("lossless (as published)", recording, array, moments.data, matrix, center)
    moments, matrix, center = _fit(recording)
    errors = _errors(moments, matrix, center)
    factor = 1.0 if moments.data.has_scalar else float(free_scale(matrix))
    covariance = sandwich(moments, errors, factor)
    estimate = Estimate(errors, covariance, covariance_from_noise=False, intensity_T=moments.data.radius_T / factor)
    return make_calibration(_NAME, recording, array, estimate)


def estimate(recording: SampleSource) -> SensorErrors:
    """Return the errors alone, without covariance and quality: the same numbers in a third of the time.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    return _errors(*_fit(recording))


def _fit(recording: SampleSource) -> tuple[Moments, FloatArray, FloatArray]:
    """Return the moments, and from them matrices D Λ (K, 3, 3) and centres (K, 3)."""
    moments = gather(recording, _NAME, groups=1)
    center = ellipsoid.center_of(moments.quartic)
    return moments, _matrix_about(moments, center)[0], center[0]


def _errors(moments: Moments, matrix: FloatArray, center: FloatArray) -> SensorErrors:
    factor = 1.0 if moments.data.has_scalar else float(free_scale(matrix))
    errors = SensorErrors.from_matrix(factor * matrix, moments.data.origin_T + moments.data.radius_T * center)
    errors.misalignment[0] = 0
    return errors


def _matrix_about(moments: Moments, center: FloatArray) -> FloatArray:
    """Return the matrices D Λ (S, K, 3, 3) of steps 2 and 3, about the centres (S, K, 3) of step 1."""
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    rotation = procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    matrix: FloatArray = inv(unmix) @ rotation
    return matrix
