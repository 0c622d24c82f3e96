"""The normalisation of the data, and the scale that a recording without scalar reference leaves open."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.normal_equations import gram
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


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
