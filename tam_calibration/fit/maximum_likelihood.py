"""The joint maximum-likelihood fit of all sensors; outliers are held down by a multivariate Student-t distribution.

It begins at a closed form that is nearly the maximum of the likelihood. The three principal components of the whitened
channels give the field up to an affine map, and an ellipsoid fit of their scores against the scalar reference fixes
that map up to a rotation.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.least_squares import gram
from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.ellipsoid import Normalized, normalize
from tam_calibration.fit.estimate import make_calibration, student_noises
from tam_calibration.fit.information import NOT_ONE, descend, parameter_covariance
from tam_calibration.fit.likelihood import Likelihood, Linearization
from tam_calibration.fit.moments import into_frame_of_first
from tam_calibration.fit.reference import interpolate, is_worth_interpolating
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
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


class Point(NamedTuple):
    """Matrices D Λ (K, 3, 3) and biases (K, 3)."""

    matrix: FloatArray
    bias: FloatArray


def free_rows(count: int) -> np.ndarray:
    """Return which of the rows of [D Λ | o] are fitted: not what lies below the diagonal of the first matrix."""
    free = np.ones(12 * count, dtype=bool)
    free[[4, 8, 9]] = False
    return free


def gauss_newton(
    linearize: Callable[[Point], Linearization], point: Point, robust: bool = False
) -> tuple[Point, FloatArray]:
    """Return the point where the iteration settles, and the information a last step before, far below its errors.

    Parameters
    ----------
    linearize : Callable
        Information and gradient of the likelihood at a point, both over all parameters.
    point : Point
        Where to begin.
    robust : bool
        Whether the weights of the samples change from step to step.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid.
    Refused
        When the iteration does not settle, or goes astray.
    """
    free = free_rows(len(point.matrix))

    def normal_at(there: Point) -> tuple[FloatArray, FloatArray, FloatArray]:
        here = linearize(there).both
        return here.information[np.ix_(free, free)], here.score[free], here.information

    def moved(before: Point, change: FloatArray) -> Point:
        # Size of a step of matrices and biases, which are of order one, from which no way leads back.
        if not np.abs(change).max() < 1e6:
            raise Refused(f"the fit goes astray: {NOT_ONE}")
        step = np.zeros(free.size)
        step[free] = change
        update = step.reshape(-1, 3, 4)
        return Point(before.matrix + update[..., :3], before.bias + update[..., 3])

    return descend(normal_at, moved, point, robust)


def maximum_likelihood(recording: SampleSource, array: Array, *, robust: bool = False) -> Calibration:
    """Fit the errors of the sensors by maximum likelihood.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field. Between the readings of a scalar magnetometer that is slower than the sensors the
        intensity is interpolated, see ``reference``; other samples without one count with what the sensors say of each
        other. Without any scalar reading the intensity is an unknown constant. The interpolation, as a robust fit,
        needs all samples in memory.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.
    robust : bool
        Whether the noise is taken for Student-t with six degrees of freedom, so that outliers count little. Two scales
        are estimated, of the differences of the sensors and of the common mode. Without outliers this costs a few per
        cent of the standard errors. The intensity is not interpolated: what samples share cannot be weighed sample by
        sample.

    Returns
    -------
    Calibration
        With the covariance of the estimate: the inverse of its Fisher information, or its sandwich form.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    Refused
        When the iteration does not settle.
    """
    if robust:
        recording = recording.whole()
    noisy, _ = complete_noise(array, recording)
    data = normalize(recording)
    point, information = _fit(recording, noisy, data, robust)
    errors, factor = _errors(data, point)
    intensity_T = data.radius_T / factor
    covariance = parameter_covariance(information, errors, data.radius_T, None if data.has_scalar else intensity_T)
    name = "robust" if robust else "maximum_likelihood"
    return make_calibration(name, recording, array, errors, covariance, intensity_T)


def estimate(recording: SampleSource, array: Array) -> SensorErrors:
    """Return the errors alone, without covariance and quality: the same numbers in less time.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field, as in ``maximum_likelihood``.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    Refused
        When the iteration does not settle.
    """
    noisy, _ = complete_noise(array, recording)
    data = normalize(recording)
    return _errors(data, _fit(recording, noisy, data)[0])[0]


def first_guess(recording: SampleSource, array: KnownNoiseArray) -> SensorErrors:
    """Return the errors that the iteration starts from: those of the closed form.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field.
    array : KnownNoiseArray
        With every noise.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    data = normalize(recording)
    return _errors(data, Point(*closed_form(data, *data.noise_of(array))))[0]


def _errors(data: Normalized, point: Point) -> tuple[SensorErrors, float]:
    """Return the errors at a point, and by how much their scale exceeds that of the data.

    Raises
    ------
    InputError
        When the point is that of no sensors: the iteration went astray.
    """
    if not (np.linalg.slogdet(point.matrix).sign > 0).all():
        raise InputError(ellipsoid.NO_ELLIPSOID)
    return data.errors_at(point.matrix, point.bias)


def _fit(
    recording: SampleSource, array: KnownNoiseArray, data: Normalized, robust: bool = False
) -> tuple[Point, FloatArray]:
    """Return the estimate and its information, the intensity interpolated where it is slow."""
    likelihood = likelihood_of(recording, array, data, may_interpolate=not robust)
    point = Point(*closed_form(data, *data.noise_of(array)))
    point, information = gauss_newton(partial(_linearize, likelihood, robust), point, robust)
    if robust:
        differential, common = student_noises(likelihood, *point)
        # The residuals are smaller than the noise by what the errors have taken of it.
        channels = float(likelihood.channel_count.sum())
        kept = max(channels - 12 * recording.sensor_count, 1.0) / channels
        here = _linearize(likelihood, False, point)
        information = here.between.information / differential.variance_factor
        information = kept * (information + here.common.information / common.variance_factor)
    return point, information


def likelihood_of(
    recording: SampleSource, array: KnownNoiseArray, data: Normalized, may_interpolate: bool = True
) -> Likelihood:
    """Return the likelihood of samples in a uniform field, the intensity interpolated where it is slow.

    Parameters
    ----------
    recording : SampleSource
        The samples.
    array : KnownNoiseArray
        Of their sensors.
    data : Normalized
        The same samples.
    may_interpolate : bool
        Whether the intensity between two readings lies on a line.
    """
    vector_noise, scalar_noise = data.noise_of(array)
    if not (may_interpolate and is_worth_interpolating(recording)):
        return Likelihood(data, vector_noise, scalar_noise)
    whole = recording.whole()
    intensity, shared_noise = interpolate(whole.time_s, data.intensity, scalar_noise)
    return Likelihood(replace(data, source=whole), vector_noise, 0.0, intensity, shared_noise)


def _linearize(likelihood: Likelihood, robust: bool, point: Point) -> Linearization:
    weights = None
    if robust:
        weights = np.array([noise.weights / noise.square for noise in student_noises(likelihood, *point)])
    return likelihood.linearize(point.matrix, point.bias, weights)
