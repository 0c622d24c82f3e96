"""The linear ellipsoid fit of Wu 2025 step 1 from moments, with a varying intensity.

The moments are those of the eleven monomials ``x² y² z² 2xy 2xz 2yz x y z 1 s²`` of points and intensity, so that
one pass over the data suffices, parts of the data can be added and taken away, and the origin can be moved afterwards.
"""

import numpy as np
from numpy.linalg import LinAlgError

from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray

NOT_AN_ELLIPSOID = (
    "do not lie on an ellipsoid around their bias: the array was not turned through enough directions, "
    "or the field or the sensor changed during the recording"
)


def monomials(points: FloatArray, intensity: FloatArray) -> FloatArray:
    """Return the (N, 11) monomials of points (N, 3) and intensities (N,)."""
    x, y, z = points.T
    columns = [x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z, np.ones_like(x), intensity**2]
    return np.stack(columns, axis=1)


def shift_origin(origin: FloatArray) -> FloatArray:
    """Return the (11, 11) matrix that turns the monomials of p into those of p - origin."""
    x, y, z = origin
    shift = np.eye(11)
    shift[0, [6, 9]] = -2 * x, x * x
    shift[1, [7, 9]] = -2 * y, y * y
    shift[2, [8, 9]] = -2 * z, z * z
    shift[3, [6, 7, 9]] = -2 * y, -2 * x, 2 * x * y
    shift[4, [6, 8, 9]] = -2 * z, -2 * x, 2 * x * z
    shift[5, [7, 8, 9]] = -2 * z, -2 * y, 2 * y * z
    shift[[6, 7, 8], 9] = -origin
    return shift


def symmetric(elements: FloatArray) -> FloatArray:
    """Return the symmetric 3 × 3 matrix of its elements xx yy zz xy xz yz."""
    xx, yy, zz, xy, xz, yz = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def solve_center(moments: FloatArray, mean_square_intensity: float) -> FloatArray:
    """Return the centre of the ellipsoid (p - o)ᵀ A (p - o) = s²/mean s².

    Solves Wu 2025 eq. 9 with the right-hand side s²/mean s² instead of 1, and again with the origin at the centre
    found, where the constant oᵀ A o that the linear form neglects vanishes.

    Parameters
    ----------
    moments : (11, 11) array
        Sum of the outer products of the monomials, points scaled to order one.
    mean_square_intensity : float
        Mean of s² in the same scale.

    Raises
    ------
    InputError
        When the points do not determine an ellipsoid.
    """
    center = np.zeros(3)
    for _ in range(20):
        shift = shift_origin(center)
        shifted = shift @ moments @ shift.T
        step = _center_of(_solve(shifted[:9, :9], shifted[:9, 10] / mean_square_intensity))
        center = center + step
        if np.abs(step).max() < 1e-15 * max(1.0, float(np.abs(center).max())):
            break
    return center


def solve_shape(moments: FloatArray, center: FloatArray) -> FloatArray:
    """Return the matrix A of (p - o)ᵀ A (p - o) = s² about a given centre: Wu 2025 eq. 13, least squares.

    Raises
    ------
    InputError
        When the points do not determine an ellipsoid.
    """
    shift = shift_origin(center)
    shifted = shift @ moments @ shift.T
    return symmetric(_solve(shifted[:6, :6], shifted[:6, 10]))


def square_root(shape: FloatArray) -> FloatArray:
    """Return the upper triangular Ω with a positive diagonal and Ωᵀ Ω = A.

    Raises
    ------
    InputError
        When A is not positive definite.
    """
    try:
        return np.linalg.cholesky(shape).T
    except LinAlgError:
        raise InputError(f"the readings {NOT_AN_ELLIPSOID}") from None


def _center_of(unknowns: FloatArray) -> FloatArray:
    """Return o from the unknowns of Wu 2025 eq. 9, whose last three are -2 A o."""
    return np.linalg.solve(symmetric(unknowns[:6]), -unknowns[6:] / 2)


def _solve(normal: FloatArray, right: FloatArray) -> FloatArray:
    scale = 1 / np.sqrt(np.diag(normal))
    try:
        if not np.isfinite(scale).all() or np.linalg.cond(normal * np.outer(scale, scale)) > 1e14:
            raise LinAlgError
        solution: FloatArray = scale * np.linalg.solve(normal * np.outer(scale, scale), scale * right)
    except LinAlgError:
        raise InputError(f"the readings {NOT_AN_ELLIPSOID}") from None
    return solution
