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
from tam_calibration.fit.result import Estimate, make_calibration
from tam_calibration.fit.scale import Normalized, free_scale, normalize
from tam_calibration.problems import InputError
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

JACKKNIFE_GROUPS = 64
FEWEST_SAMPLES = 10
"""An ellipsoid has nine parameters; one sample more lets the jackknife leave one out."""


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
    scalar = recording.scalar_T
    known = recording if scalar is None else recording.take(np.isfinite(scalar))
    if known.sample_count < FEWEST_SAMPLES:
        raise InputError(
            f"{known.sample_count} samples are too few for the lossless calibration: it needs {FEWEST_SAMPLES}"
        )
    data = normalize(known)
    quartic, joint = _moments(data)
    # The first set of moments is that of all samples; each other one leaves a group out.
    quartic = np.concatenate([[quartic.sum(axis=0)], quartic.sum(axis=0) - quartic])
    joint = np.concatenate([[joint.sum(axis=0)], joint.sum(axis=0) - joint])
    centers = _published_center(quartic, data) if as_published else ellipsoid.center_of(quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(quartic, centers))
    matrix = inv(unmix) @ _procrustes(joint, unmix, centers)
    factor = np.ones(len(matrix)) if data.has_scalar else free_scale(matrix)
    bias = data.origin_T + data.radius_T * centers
    vectors = _parameters(matrix * factor[:, None, None, None], bias)
    estimate = Estimate(
        SensorErrors.from_vector(vectors[0]),
        _jackknife(vectors[1:]),
        covariance_from_noise=False,
        intensity_T=float(data.radius_T / factor[0]),
    )
    return make_calibration("lossless (as published)" if as_published else "lossless", recording, array, estimate)


def _moments(data: Normalized) -> tuple[FloatArray, FloatArray]:
    """Return (G, K, 11, 11) moments of the monomials and (G, 3K+1, 3K+1) of all readings and 1, by groups."""
    groups = min(JACKKNIFE_GROUPS, len(data.points))
    quartic, joint = [], []
    for group in range(groups):
        points, intensity = data.points[group::groups], data.intensity[group::groups]
        rows = [ellipsoid.monomials(points[:, sensor], intensity) for sensor in range(points.shape[1])]
        quartic.append([row.T @ row for row in rows])
        everything = np.column_stack([points.reshape(len(points), -1), np.ones(len(points))])
        joint.append(everything.T @ everything)
    return np.array(quartic), np.array(joint)


def _published_center(moments: FloatArray, data: Normalized) -> FloatArray:
    """Return the centres of step 1 as printed: origin at zero reading, intensity constant, SLSQP on eq. 12."""
    origin = -data.origin_T / data.radius_T
    from_zero = ellipsoid.move_origin(moments, np.broadcast_to(origin, (len(moments), *origin.shape)))
    found = np.empty((*moments.shape[:2], 3))
    for index in np.ndindex(*moments.shape[:2]):
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


def _procrustes(joint: FloatArray, unmix: FloatArray, centers: FloatArray) -> FloatArray:
    """Return the rotations Λ (..., K, 3, 3) that turn sensor 1's restored field into each sensor's."""
    sets, sensors = unmix.shape[:2]
    product = joint[:, :-1, :-1].reshape(sets, sensors, 3, sensors, 3)[:, :, :, 0]
    total = joint[:, :-1, -1].reshape(sets, sensors, 3)
    count = joint[:, -1, -1, None, None, None]
    first = centers[:, :1]
    cross = (
        product
        - centers[..., :, None] * total[:, :1, None, :]
        - total[..., :, None] * first[..., None, :]
        + count * centers[..., :, None] * first[..., None, :]
    )
    left, _, right = np.linalg.svd(unmix @ cross @ np.swapaxes(unmix[:, :1], -1, -2))
    handedness = np.linalg.det(left @ right)
    for sensor in np.flatnonzero(handedness[0] < 0):
        raise InputError(f"sensor {sensor + 1} is a mirror image of sensor 1: check the order and signs of its axes")
    rotation: FloatArray = left @ right
    return rotation


def _parameters(matrix: FloatArray, bias_T: FloatArray) -> FloatArray:
    """Return the (sets, K, 12) parameters of matrices (sets, K, 3, 3) and biases (sets, K, 3)."""
    every = SensorErrors.from_matrix(matrix.reshape(-1, 3, 3), bias_T.reshape(-1, 3))
    vectors = every.to_vector().reshape(*matrix.shape[:2], 12)
    vectors[:, 0, 9:] = 0
    return vectors


def _jackknife(replicates: FloatArray) -> FloatArray:
    """Return the covariance (12 K, 12 K) from estimates that leave one group out each."""
    groups = len(replicates)
    deviation = (replicates - replicates.mean(axis=0)).reshape(groups, -1)
    covariance: FloatArray = (groups - 1) / groups * deviation.T @ deviation
    return covariance
