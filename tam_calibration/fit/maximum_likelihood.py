"""The joint maximum-likelihood fit of all sensors.

Each sample's field is eliminated exactly and Gauss-Newton solves for the 12 K - 3 parameters that a uniform field
determines. The start is nearly the solution: the three principal components of the whitened channels give the field up
to an affine map, and one ellipsoid fit of their scores against the scalar reference fixes that map up to a rotation.
"""

import numpy as np
from numpy.linalg import LinAlgError, inv

from tam_calibration.array import Array
from tam_calibration.calibration import Calibration
from tam_calibration.errors import SensorErrors
from tam_calibration.fit import ellipsoid, student
from tam_calibration.fit.bound import parameter_covariance
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.fit.noise import complete_noise
from tam_calibration.fit.result import Estimate, make_calibration
from tam_calibration.fit.scale import Normalized, free_scale, normalize
from tam_calibration.problems import InputError, Refused
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_MOST_STEPS = 100
_SMALLEST_SPREAD = 1e-12  # of readings that are not all in a plane, over the largest


def maximum_likelihood(recording: Recording, array: Array, *, robust: bool = False) -> Calibration:
    """Fit the errors of the sensors by maximum likelihood.

    Parameters
    ----------
    recording : Recording
        Samples in a uniform field. Samples without a scalar reading count with what the sensors say of each other;
        without any, the intensity is an unknown constant.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.
    robust : bool
        Whether the noise is taken for Student-t with four degrees of freedom and a scale that is estimated, so that
        outliers count little. Without outliers this costs a few per cent of the standard errors.

    Returns
    -------
    Calibration
        With the covariance of the estimate: the inverse of its Fisher information, or its sandwich form.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor is left-handed.
    Refused
        When the iteration does not settle.
    """
    noisy, _ = complete_noise(array, recording)
    assert noisy.vector_noise_T is not None
    assert noisy.scalar_noise_T is not None
    data = normalize(recording)
    vector_noise = noisy.vector_noise_T / data.radius_T
    scalar_noise = noisy.scalar_noise_T / data.radius_T if data.has_scalar else 0.0
    likelihood = Likelihood(data.points, data.intensity, vector_noise, scalar_noise)
    matrix, bias = _gauss_newton(likelihood, *_closed_form(data, vector_noise), robust)
    information = likelihood.linearize(matrix, bias).information
    if robust:
        energy, channels = likelihood.energy(matrix, bias), likelihood.channel_count
        information = information / student.variance_factor(energy, channels, student.scale_square(energy, channels))
    factor = 1.0 if data.has_scalar else float(free_scale(matrix))
    errors = SensorErrors.from_matrix(factor * matrix, data.origin_T + data.radius_T * bias)
    errors.misalignment[0] = 0
    free_intensity = None if data.has_scalar else data.radius_T / factor
    covariance = parameter_covariance(information, errors, data.radius_T, free_intensity)
    estimate = Estimate(errors, covariance, covariance_from_noise=True, intensity_T=data.radius_T / factor)
    return make_calibration("robust" if robust else "maximum_likelihood", recording, array, estimate)


def _closed_form(data: Normalized, vector_noise: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return matrices (K, 3, 3) and biases (K, 3) from principal components and one ellipsoid."""
    points = data.points.reshape(len(data.points), -1)
    weight = 1 / np.repeat(vector_noise, 3)
    weight /= weight.mean()
    mean = points.mean(axis=0)
    spread = weight[:, None] * (points.T @ points / len(points) - np.outer(mean, mean)) * weight
    values, vectors = np.linalg.eigh(spread)
    if values[-3] < _SMALLEST_SPREAD * values[-1]:
        raise InputError(ellipsoid.NO_ELLIPSOID)
    components = vectors[:, -3:]
    scores = (points - mean) @ (weight[:, None] * components)
    known = np.isfinite(data.intensity)
    rows = ellipsoid.monomials(scores[known], data.intensity[known])
    moments = rows.T @ rows
    center = ellipsoid.center_of(moments)
    shape = ellipsoid.square_root(ellipsoid.shape_about(moments, center))
    matrix = (components @ inv(shape) / weight[:, None]).reshape(-1, 3, 3)
    bias = mean + components @ center / weight
    if np.linalg.det(matrix[0]) < 0:
        matrix = -matrix
    return _into_frame_of_first(matrix), bias.reshape(-1, 3)


def _into_frame_of_first(matrix: FloatArray) -> FloatArray:
    """Turn the common frame so that the first matrix is upper triangular."""
    rotation = SensorErrors.from_matrix(matrix, np.zeros(matrix.shape[:2])).rotation[0]
    turned: FloatArray = matrix @ rotation.T
    turned[0][np.tril_indices(3, -1)] = 0
    return turned


def _gauss_newton(
    likelihood: Likelihood, matrix: FloatArray, bias: FloatArray, robust: bool
) -> tuple[FloatArray, FloatArray]:
    free = np.ones(12 * len(matrix), dtype=bool)
    free[[4, 8, 9]] = False  # what lies below the diagonal of the first matrix
    previous = np.inf
    for _ in range(_MOST_STEPS):
        weights = _student_weights(likelihood, matrix, bias) if robust else None
        point = likelihood.linearize(matrix, bias, weights)
        step = np.zeros(free.size)
        step[free] = _solve(point.information[np.ix_(free, free)], point.gradient[free])
        # Twice the fall of the likelihood that the step promises; below one it is part of a standard error.
        decrement = float(step @ point.gradient)
        update = step.reshape(-1, 3, 4)
        matrix, bias = matrix + update[..., :3], bias + update[..., 3]
        # Newton's steps fall quadratically until rounding stops them, those with new weights by a constant factor.
        is_rounding = not robust and decrement < 1e-2 and decrement > previous / 4
        if is_rounding or decrement < (1e-8 if robust else 1e-12):
            return matrix, bias
        previous = decrement
    raise Refused(
        f"the fit did not settle in {_MOST_STEPS} steps: the readings do not fit one calibration, "
        "look for a change of field or sensor during the recording"
    )


def _student_weights(likelihood: Likelihood, matrix: FloatArray, bias: FloatArray) -> FloatArray:
    energy, channels = likelihood.energy(matrix, bias), likelihood.channel_count
    square = student.scale_square(energy, channels)
    return student.weights(energy, channels, square) / square


def _solve(information: FloatArray, gradient: FloatArray) -> FloatArray:
    diagonal = np.diag(information)
    if not (diagonal > 0).all():
        raise InputError(ellipsoid.NO_ELLIPSOID)
    scale = 1 / np.sqrt(diagonal)
    try:
        step: FloatArray = scale * np.linalg.solve(information * np.outer(scale, scale), scale * gradient)
    except LinAlgError:
        raise InputError(ellipsoid.NO_ELLIPSOID) from None
    return step
