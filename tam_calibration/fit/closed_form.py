"""The closed form of the joint fit: nearly the maximum of the likelihood.

The three principal components of the whitened channels give the field up to an affine map, and an ellipsoid fit of
their scores against the scalar reference fixes that map up to a rotation.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.normal_equations import gram
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.handedness import require_one_hand
from tam_calibration.fit.scale import Normalized
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_SMALLEST_SPREAD = 1e-12  # of readings that are not all in a plane, over the largest


def closed_form(data: Normalized, vector_noise: FloatArray, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return what principal components and an ellipsoid tell of the sensors: the start of ``maximum_likelihood``.

    The ellipsoid is fitted twice, the second time with the variance that the sensors' scale factors give each
    direction. In a uniform field of steady intensity what is left to the iteration is far below the standard errors.

    Parameters
    ----------
    data : Normalized
        Samples in a uniform field.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes, in the unit of the data.
    scalar_noise : float
        Standard deviation of the intensity; zero for an unknown constant.

    Returns
    -------
    (K, 3, 3) array, (K, 3) array
        Matrices D Λ and biases, about the origins and in the unit of the data.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid.
    """
    precision = 1 / np.repeat(vector_noise, 3)
    weight = precision / precision.mean()
    count = data.moments[-1, -1]
    mean = data.moments[-1, :-1] / count
    spread = weight[:, None] * (data.moments[:-1, :-1] / count - np.outer(mean, mean)) * weight
    values, vectors = np.linalg.eigh(spread)
    if values[-3] < _SMALLEST_SPREAD * values[-1]:
        raise InputError(ellipsoid.NO_ELLIPSOID)
    components = vectors[:, -3:]
    scores = _Scores(data, (weight[:, None] * components).T, mean)
    center, shape = _weighted_ellipsoid(scores, 1 / precision.mean(), scalar_noise)
    matrix = (components @ inv(shape) / weight[:, None]).reshape(-1, 3, 3)
    bias = mean + components @ center / weight
    if np.linalg.det(matrix[0]) < 0:
        matrix = -matrix
    return _into_frame_of_first(matrix), bias.reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class _Scores:
    """Three principal components of readings about their mean, and the intensities there are."""

    data: Normalized
    projection: FloatArray
    mean: FloatArray

    def blocks(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        centered = np.column_stack([self.projection, -self.projection @ self.mean])
        for points, intensity in self.data.blocks():
            scores = centered @ points
            known = np.isfinite(intensity)
            yield (scores, intensity) if known.all() else (scores[:, known], intensity[known])


def _weighted_ellipsoid(scores: _Scores, noise: float, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return the centre o and the square root Ω of the ellipsoid |Ω (p - o)| = s of scores with equal noise."""
    center, shape = _ellipsoid(_moments(scores, lambda points: 1.0))

    def variance(points: FloatArray) -> FloatArray:
        field = shape @ (points - center[:, None])
        along = shape.T @ field
        square = np.einsum("in,in->n", along, along) / np.einsum("in,in->n", field, field)
        of_length: FloatArray = noise**2 * square + scalar_noise**2
        return of_length

    try:
        return _ellipsoid(_moments(scores, variance))
    except InputError:
        # Readings that hardly determine an ellipsoid do not tell the weights either.
        return center, shape


def _moments(scores: _Scores, variance: Callable[[FloatArray], FloatArray | float]) -> FloatArray:
    """Return the (11, 11) moments of the monomials, each sample over its variance."""
    moments = np.zeros((11, 11))
    for points, intensity in scores.blocks():
        columns = ellipsoid.monomial_columns(points, intensity)
        columns *= 1 / np.sqrt(variance(points))
        moments += gram(columns)
    return moments


def _ellipsoid(moments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the centre o and the square root Ω of the ellipsoid |Ω (p - o)| = s."""
    center = ellipsoid.center_of(moments)
    return center, ellipsoid.square_root(ellipsoid.shape_about(moments, center))


def _into_frame_of_first(matrix: FloatArray) -> FloatArray:
    """Turn the common frame so that the first matrix is upper triangular."""
    require_one_hand(matrix)
    rotation = SensorErrors.from_matrix(matrix, np.zeros(matrix.shape[:2])).rotation[0]
    turned: FloatArray = matrix @ rotation.T
    turned[0][np.tril_indices(3, -1)] = 0
    return turned
