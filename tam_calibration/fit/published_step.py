"""Step 1 of Wu 2025 as it is printed: sequential quadratic programming on eq. 12, with a constant intensity."""

import numpy as np

from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import Moments
from tam_calibration.units import FloatArray


def published_center(moments: Moments) -> FloatArray:
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
