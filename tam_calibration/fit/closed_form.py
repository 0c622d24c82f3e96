"""The closed form that every fit without a prior begins at: nearly the maximum of the likelihood.

The three principal components of the whitened channels give the field up to an affine map, and an ellipsoid fit of
their scores against the scalar reference fixes that map up to a rotation.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.least_squares import gram
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.moments import into_frame_of_first
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import SKETCH
from tam_calibration.model.units import FloatArray


def closed_form(data: Normalized, vector_noise: FloatArray, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return what ``principal_form`` tells of some samples in the frame of sensor 1: where the iteration starts.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    some = data if data.source.sample_count <= SKETCH else replace(data, source=data.source.thinned(SKETCH))
    matrix, bias = principal_form(some, vector_noise, scalar_noise)
    return into_frame_of_first(matrix[None])[0], bias


def principal_form(data: Normalized, vector_noise: FloatArray, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return what principal components and an ellipsoid tell of the sensors, in any common frame.

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
    # Smallest over largest variance of readings that are not all in a plane: rounding leaves 1e-16 of a plane.
    if values[-3] < 1e-12 * values[-1]:
        raise InputError(ellipsoid.NO_ELLIPSOID)
    components = vectors[:, -3:]
    projection = (weight[:, None] * components).T
    scores = partial(_scores, data, np.column_stack([projection, -projection @ mean]))
    center, shape = _weighted_ellipsoid(scores, 1 / precision.mean(), scalar_noise)
    matrix = (components @ inv(shape) / weight[:, None]).reshape(-1, 3, 3)
    bias = mean + components @ center / weight
    if np.linalg.det(matrix[0]) < 0:
        matrix = -matrix
    return matrix, bias.reshape(-1, 3)


_ScoresOfBlocks = Callable[[], Iterator[tuple[FloatArray, FloatArray]]]


def _scores(data: Normalized, principal: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield three principal components (3, n) of readings about their mean, and the intensities (n,) there are."""
    for points, intensity in data.blocks():
        known = np.isfinite(intensity)
        scores = principal @ points
        yield (scores, intensity) if known.all() else (scores[:, known], intensity[known])


def _weighted_ellipsoid(scores: _ScoresOfBlocks, noise: float, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return the centre o and the square root Ω of the ellipsoid |Ω (p - o)| = s of scores with equal noise."""
    center, shape = ellipsoid.fitted(_moments(scores, lambda points: 1.0))

    def variance(points: FloatArray) -> FloatArray:
        field = shape @ (points - center[:, None])
        along = shape.T @ field
        square = np.einsum("in,in->n", along, along) / np.einsum("in,in->n", field, field)
        return np.asarray(noise**2 * square + scalar_noise**2)

    try:
        return ellipsoid.fitted(_moments(scores, variance))
    except InputError:
        # Readings that hardly determine an ellipsoid do not tell the weights either.
        return center, shape


def _moments(scores: _ScoresOfBlocks, variance: Callable[[FloatArray], FloatArray | float]) -> FloatArray:
    """Return the (11, 11) moments of the monomials, each sample over its variance."""
    moments = np.zeros((11, 11))
    for points, intensity in scores():
        columns = ellipsoid.monomial_columns(points, intensity)
        columns *= 1 / np.sqrt(variance(points))
        moments += gram(columns)
    return moments
