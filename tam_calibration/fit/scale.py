"""The normalisation of the data, and the scale that a recording without scalar reference leaves open."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.errors import SensorErrors
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_SAMPLES_FOR_SPHERE = 2_000
_REWEIGHTINGS = 40
_SMALLEST_DISTANCE = 1e-4


@dataclass(frozen=True, eq=False)
class Normalized:
    """Readings about their spheres' centres and in units of a radius, so that all numbers are of order one.

    Parameters
    ----------
    points : (N, K, 3) array
        (reading - origin) / radius.
    intensity : (N,) array
        Scalar reading / radius, NaN where there is none; 1 throughout without a scalar reference.
    origin_T : (K, 3) array
        Centre of the sphere through each sensor's readings, tesla.
    radius_T : float
        Mean radius of these spheres, tesla.
    has_scalar : bool
        Whether the intensity comes from a scalar reference.
    """

    points: FloatArray
    intensity: FloatArray
    origin_T: FloatArray
    radius_T: float
    has_scalar: bool


def sphere_center(points: FloatArray) -> FloatArray:
    """Return the centres (..., 3) of the least-squares spheres |p|² = 2 p·c + constant through points (..., N, 3).

    Where the points do not determine it, as in a plane, the one nearest to their mean is returned.
    """
    mean = points.mean(axis=-2, keepdims=True)
    centered = points - mean
    square = np.sum(centered**2, axis=-1)
    size = np.maximum(np.sqrt(square.mean(axis=-1))[..., None, None], np.finfo(float).tiny)
    # The mean takes the constant out of the normal equations of the centre.
    half = centered / size
    normal = np.swapaxes(half, -1, -2) @ half
    right = np.sum(half * (square / size[..., 0] ** 2)[..., None], axis=-2)[..., None] / 2
    center: FloatArray = mean + size * np.swapaxes(np.linalg.pinv(normal, 1e-12, hermitian=True) @ right, -1, -2)
    return center[..., 0, :]


def sphere_of_most(points: FloatArray) -> tuple[FloatArray, float]:
    """Return centre (3,) and radius of the sphere with the least sum of absolute distances to points (N, 3).

    Up to a third of the points may lie elsewhere without moving it much. By iteratively reweighted least squares.
    """
    design = np.column_stack([2 * points, np.ones(len(points))])
    square = np.sum(points**2, axis=1)
    weight = np.ones(len(points))
    for _ in range(_REWEIGHTINGS):
        solution = np.linalg.lstsq(design * weight[:, None], square * weight, rcond=None)[0]
        center = solution[:3]
        radius = float(np.sqrt(max(solution[3] + center @ center, 0.0)))
        distance = np.abs(norm(points - center, axis=1) - radius)
        weight = 1 / np.sqrt(np.maximum(distance, _SMALLEST_DISTANCE * norm(points, axis=1).mean()))
    return center, radius


def normalize(recording: Recording) -> Normalized:
    """Return the recording's readings and intensity in units of order one."""
    stride = -(-recording.sample_count // _SAMPLES_FOR_SPHERE)
    some = recording.readings_T[::stride]
    origin = sphere_center(np.swapaxes(some, 0, 1))
    radius = float(norm(some - origin, axis=2).mean())
    scalar = recording.scalar_T
    intensity = np.ones(recording.sample_count) if scalar is None else scalar / radius
    return Normalized((recording.readings_T - origin) / radius, intensity, origin, radius, scalar is not None)


def free_scale(matrix: FloatArray) -> FloatArray:
    """Return the factors (...) that give matrices (..., K, 3, 3) determinants of geometric mean 1."""
    factor: FloatArray = np.exp(-np.log(np.linalg.det(matrix)).mean(axis=-1) / 3)
    return factor


def free_scale_gradient(errors: SensorErrors) -> FloatArray:
    """Return the (12 K,) gradient of the mean log determinant that ``free_scale`` holds, by the parameters."""
    gradient = np.zeros((errors.sensor_count, 12))
    gradient[:, :3] = 1 / errors.scale_factor
    gradient[:, 3:6] = -np.tan(errors.non_orthogonality)
    return gradient.ravel()
