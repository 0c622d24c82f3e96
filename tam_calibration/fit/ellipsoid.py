"""Spheres and ellipsoids that readings lie on, the unit in which they are of order one, and the scale they leave open.

The linear ellipsoid fit of Wu 2025 takes moments, with a varying intensity. They are those of the eleven monomials
``x² y² z² 2xy 2xz 2yz x y z 1 s²`` of points and intensity, so that one pass over the data suffices, parts of the data
can be added and taken away, and the origin can be moved afterwards. Its functions take any number of leading axes and
treat each set of moments apart.

Of several sensors the three principal components of all readings give the field up to an affine map, and an ellipsoid
of these components fixes that map up to a rotation: nearly the maximum of the likelihood.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.linalg import LinAlgError, inv, norm

from tam_calibration.core.least_squares import gram, scaled
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
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


def monomial_columns(points: FloatArray, intensity: FloatArray) -> FloatArray:
    """Return the monomials of points and intensity, in the order of the moments.

    Parameters
    ----------
    points : (3, N) array
        Readings of one sensor, of order one.
    intensity : (N,) array
        Reference intensity s of each sample, in the same unit.

    Returns
    -------
    (11, N) array
        A row for each monomial.
    """
    columns = np.empty((11, points.shape[1]))
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
    unit, scale = scaled(matrix)
    return np.asarray(np.linalg.solve(unit, (right / scale)[..., None])[..., 0] / scale)


@dataclass(frozen=True, eq=False)
class Normalized:
    """Readings about their spheres' centres and in units of a radius, so that all numbers are of order one.

    Parameters
    ----------
    source : SampleSource
        The readings.
    origin_T : (K, 3) array
        Centre of the sphere through each sensor's readings, tesla.
    radius_T : float
        Mean radius of these spheres, tesla.
    has_scalar : bool
        Whether the intensity comes from a scalar reference; of a part of a recording, whether that of the whole does.
    """

    source: SampleSource
    origin_T: FloatArray
    radius_T: float
    has_scalar: bool

    def blocks(self) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield the (3K + 1, n) readings and 1, and the (n,) intensities, of one block after the other.

        The intensity is NaN where there is no scalar reading, and 1 throughout without a scalar reference.
        """
        origin = self.origin_T.reshape(-1, 1)
        for block in self.source.blocks():
            count = len(block.time_s)
            points = np.empty((len(origin) + 1, count))
            np.subtract(block.readings_T.reshape(count, -1).T, origin, out=points[:-1])
            points[:-1] *= 1 / self.radius_T
            points[-1] = 1
            yield points, self._intensity(block.scalar_T, count)

    @property
    def points(self) -> FloatArray:
        """(N, K, 3) readings, all at once."""
        return (self.source.whole().readings_T - self.origin_T) / self.radius_T

    @property
    def intensity(self) -> FloatArray:
        """(N,) intensities, all at once."""
        recording = self.source.whole()
        return self._intensity(recording.scalar_T, recording.sample_count)

    def _intensity(self, scalar_T: FloatArray | None, count: int) -> FloatArray:
        if scalar_T is None:
            return np.full(count, np.nan if self.has_scalar else 1.0)
        return scalar_T / self.radius_T

    def noise_of(self, array: KnownNoiseArray) -> tuple[FloatArray, float]:
        """Return the noise (K,) of an array's sensors, and of the intensity, in units of the radius."""
        return array.vector_noise_T / self.radius_T, array.scalar_noise_T / self.radius_T if self.has_scalar else 0.0

    def errors_at(self, matrix: FloatArray, bias: FloatArray) -> tuple[SensorErrors, float]:
        """Return the errors of sensors in the frame of the first, and by how much their scale exceeds that of the data.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            About the origins, in units of the radius.
        """
        factor = 1.0 if self.has_scalar else float(free_scale(matrix))
        errors = SensorErrors.from_matrix(factor * matrix, self.origin_T + self.radius_T * bias)
        errors.misalignment[0] = 0
        return errors, factor

    @cached_property
    def moments(self) -> FloatArray:
        """(3K + 1, 3K + 1) sum of the outer products of the readings of a sample followed by 1."""
        return sum((gram(points) for points, _ in self.blocks()), np.zeros(()))


def sphere_center(points: FloatArray) -> FloatArray:
    """Return the centres (..., 3) of the least-squares spheres |p|² = 2 p·c + constant through points (..., N, 3).

    Where the points do not determine it, as in a plane, the one nearest to their mean is returned.
    """
    columns = np.ascontiguousarray(np.swapaxes(points, -1, -2))
    mean = columns.mean(axis=-1, keepdims=True)
    columns = columns - mean
    square = np.einsum("...in,...in->...n", columns, columns)[..., None]
    # No smaller than what has a cube, so that points that are all the same have a centre too.
    size = np.maximum(np.sqrt(square.mean(axis=-2, keepdims=True)), np.cbrt(np.finfo(float).tiny))
    # The mean takes the constant out of the normal equations of the centre.
    normal, right = columns @ np.swapaxes(columns, -1, -2) / size**2, columns @ square / (2 * size**3)
    values, vectors = np.linalg.eigh(normal)
    inverse = np.divide(1, values, out=np.zeros_like(values), where=values > 1e-12 * values[..., -1:])
    center: FloatArray = mean + size * (vectors @ (inverse[..., None] * (np.swapaxes(vectors, -1, -2) @ right)))
    return center[..., 0]


def sphere_of_most(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius of the sphere with the least sum of absolute distances to points (N, 3).

    Up to a third of the points may lie elsewhere without moving it much. By iteratively reweighted least squares.
    """
    design = np.column_stack([2 * points, np.ones(len(points))])
    square = np.sum(points**2, axis=1)
    weight = np.ones(len(points))
    # Of the least absolute distances, which come nearer by a constant part each time.
    for _ in range(40):
        solution = np.linalg.lstsq(design * weight[:, None], square * weight, rcond=None)[0]
        center = solution[:3]
        radius = float(np.sqrt(max(solution[3] + center @ center, 0.0)))
        distance = np.abs(norm(points - center, axis=1) - radius)
        # Part of the radius below which a distance weighs no more, so that no weight is infinite.
        weight = 1 / np.sqrt(np.maximum(distance, 1e-4 * norm(points, axis=1).mean()))
    return center, radius


def normalize(source: SampleSource) -> Normalized:
    """Return the readings and intensity in units of order one."""
    # From which centre and radius are taken: they only make the numbers of order one.
    some = source.thinned(400).readings_T
    origin = sphere_center(np.swapaxes(some, 0, 1))
    centered = some - origin
    radius_T = float(np.sqrt(np.einsum("nki,nki->nk", centered, centered)).mean())
    return Normalized(source, origin, radius_T, source.scalar_count is not None)


def free_scale(matrix: FloatArray) -> FloatArray:
    """Return the factors (...) that give matrices (..., K, 3, 3) determinants of geometric mean 1."""
    return np.asarray(np.exp(-np.log(np.linalg.det(matrix)).mean(axis=-1) / 3))


def free_scale_gradient(errors: SensorErrors) -> FloatArray:
    """Return the (12 K,) gradient of the mean log determinant that ``free_scale`` holds, by the parameters."""
    gradient = np.zeros((errors.sensor_count, 12))
    gradient[:, :3] = 1 / errors.scale_factor
    gradient[:, 3:6] = -np.tan(errors.non_orthogonality)
    return gradient.ravel()


def without_scale(errors: SensorErrors) -> FloatArray:
    """Return the (12 K, 12 K) projection of changes of the errors on those that keep the mean determinant.

    Parameters
    ----------
    errors : SensorErrors
        Of K sensors, which are changed.
    """
    gradient, scale = free_scale_gradient(errors), errors.to_vector()
    scale[:, 3:] = 0
    return np.eye(gradient.size) - np.outer(scale, gradient) / (gradient @ scale.ravel())


def principal_form(data: Normalized, vector_noise: FloatArray, scalar_noise: float) -> tuple[FloatArray, FloatArray]:
    """Return what principal components and an ellipsoid tell of the sensors, in any common frame.

    The ellipsoid is fitted twice, the second time with the variance that the sensors' scale factors give each
    direction. In a uniform field of steady intensity the iteration changes it by far less than a standard error.

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
        raise InputError(NO_ELLIPSOID)
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
    center, shape = fitted(_moments(scores, lambda points: 1.0))

    def variance(points: FloatArray) -> FloatArray:
        field = shape @ (points - center[:, None])
        along = shape.T @ field
        square = np.einsum("in,in->n", along, along) / np.einsum("in,in->n", field, field)
        return np.asarray(noise**2 * square + scalar_noise**2)

    try:
        return fitted(_moments(scores, variance))
    except InputError:
        # Readings that hardly determine an ellipsoid do not tell the weights either.
        return center, shape


def _moments(scores: _ScoresOfBlocks, variance: Callable[[FloatArray], FloatArray | float]) -> FloatArray:
    """Return the (11, 11) moments of the monomials, each sample over its variance."""
    moments = np.zeros((11, 11))
    for points, intensity in scores():
        columns = monomial_columns(points, intensity)
        columns *= 1 / np.sqrt(variance(points))
        moments += gram(columns)
    return moments
