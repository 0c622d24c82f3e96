"""The linear ellipsoid fit of Wu 2025 from moments, with a varying intensity.

The moments are those of the eleven monomials ``x² y² z² 2xy 2xz 2yz x y z 1 s²`` of points and intensity, so that
one pass over the data suffices, parts of the data can be added and taken away, and the origin can be moved afterwards.
Every function takes any number of leading axes and treats each set of moments apart.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
from numpy.linalg import LinAlgError

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

NO_ELLIPSOID = (
    "the readings do not lie on an ellipsoid: the array was not turned through enough directions, "
    "or the field or a sensor changed during the recording"
)


@contextmanager
def determined() -> Iterator[None]:
    """Say of singular equations that the readings determine no ellipsoid.

    Raises
    ------
    InputError
        Where a block or function raises LinAlgError.
    """
    try:
        yield
    except LinAlgError:
        raise InputError(NO_ELLIPSOID) from None


ROWS, COLUMNS = np.array([[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
"""Row and column of the six elements xx yy zz xy xz yz of a symmetric matrix."""


def _shifts() -> FloatArray:
    """Return (9, 121): how the monomials change with the origin x y z and with its pairs."""
    shift = np.zeros((9, 11, 11))
    for element, (row, column) in enumerate(zip(ROWS, COLUMNS, strict=True)):
        factor = 1 if row == column else 2
        # (p - o)(p - o)ᵀ = p pᵀ - p oᵀ - o pᵀ + o oᵀ
        shift[row, element, 6 + column] -= factor
        shift[column, element, 6 + row] -= factor
        shift[3 + element, element, 9] = factor
    shift[range(3), range(6, 9), 9] = -1
    return shift.reshape(9, -1)


_SHIFT = _shifts()


def monomial_columns(points: FloatArray, intensity: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Return the monomials of points and intensity, in the order of the moments.

    Parameters
    ----------
    points : (3, N) array
        Readings of one sensor, of order one.
    intensity : (N,) array
        Reference intensity s of each sample, in the same unit.
    out : (11, N) array, optional
        Where to write the monomials; by default a new array.

    Returns
    -------
    (11, N) array
        ``out``, or the new array.
    """
    columns = np.empty((11, points.shape[1])) if out is None else out
    np.multiply(points, points, out=columns[:3])
    np.multiply(points[0], points[1:], out=columns[3:5])
    np.multiply(points[1], points[2], out=columns[5])
    columns[3:6] *= 2
    columns[6:9] = points
    columns[9] = 1
    np.multiply(intensity, intensity, out=columns[10])
    return columns


def move_origin(moments: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the moments of points seen from another origin.

    Parameters
    ----------
    moments : (..., 11, 11) array
        Sums of the outer products of the monomials.
    origin : (..., 3) array
        The new origin, in the unit of the points.

    Returns
    -------
    (..., 11, 11) array
        The same sums for the points less the origin; the intensity stays.
    """
    pairs = origin[..., ROWS] * origin[..., COLUMNS]
    shift = (np.concatenate([origin, pairs], axis=-1) @ _SHIFT).reshape(moments.shape) + np.eye(11)
    return shift @ moments @ np.swapaxes(shift, -1, -2)


def symmetric(elements: FloatArray) -> FloatArray:
    """Return the symmetric (..., 3, 3) matrices of their elements (..., 6) xx yy zz xy xz yz."""
    return elements[..., [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(*elements.shape[:-1], 3, 3)


@determined()
def center_of(moments: FloatArray) -> FloatArray:
    """Return the centres (..., 3) of the ellipsoids (p - o)ᵀ A (p - o) = s²/mean s².

    This is Wu 2025 eq. 9 with the right-hand side s²/mean s² instead of 1, solved again with the origin at the
    centre found until it stays: there the constant oᵀ A o vanishes, which a varying s would otherwise not let pass
    into the scale of A.

    Raises
    ------
    InputError
        When the points do not determine an ellipsoid.
    """
    mean_square = moments[..., 9, 10] / moments[..., 9, 9]
    center, moved = np.zeros((*moments.shape[:-2], 3)), moments
    for _ in range(20):
        # (p - o)ᵀ A (p - o) = r is pᵀ A p - 2 (A o)ᵀ p = r - oᵀ A o: linear in A and A o (Wu 2025 eq. 9).
        unknowns = _solve(moved[..., :9, :9], moved[..., :9, 10] / mean_square[..., None])
        step = np.linalg.solve(symmetric(unknowns[..., :6]), -unknowns[..., 6:, None] / 2)[..., 0]
        center = center + step
        # What is neglected is quadratic in the step.
        if np.abs(step).max() < 1e-8:
            break
        moved = move_origin(moments, center)
    return center


def shape_about(moments: FloatArray, center: FloatArray) -> FloatArray:
    """Return the matrices A of the ellipsoids (p - o)ᵀ A (p - o) = s² about given centres: Wu 2025 eq. 13.

    Parameters
    ----------
    moments : (..., 11, 11) array
        Sums of the outer products of the monomials, points scaled to order one.
    center : (..., 3) array
        Centres o, in the unit of the points.

    Returns
    -------
    (..., 3, 3) array
        Symmetric matrices A.

    Raises
    ------
    InputError
        When the points do not determine an ellipsoid.
    """
    moved = move_origin(moments, center)
    return symmetric(_solve(moved[..., :6, :6], moved[..., :6, 10]))


@determined()
def square_root(shape: FloatArray) -> FloatArray:
    """Return the upper triangular Ω (..., 3, 3) with a positive diagonal and Ωᵀ Ω = A.

    Raises
    ------
    InputError
        When A is not positive definite.
    """
    return np.swapaxes(np.linalg.cholesky(shape), -1, -2)


def fitted(moments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the centres o (..., 3) and the roots Ω (..., 3, 3) of the ellipsoids |Ω (p - o)| = s.

    Raises
    ------
    InputError
        When the points do not determine an ellipsoid.
    """
    center = center_of(moments)
    return center, square_root(shape_about(moments, center))


@determined()
def _solve(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve symmetric systems after scaling the rows and columns to a unit diagonal."""
    scale = 1 / np.sqrt(np.maximum(np.diagonal(matrix, axis1=-2, axis2=-1), np.finfo(float).tiny))
    scaled = matrix * scale[..., :, None] * scale[..., None, :]
    return np.asarray(scale * np.linalg.solve(scaled, (scale * right)[..., None])[..., 0])
