"""The nominal fit: the calibration that a diagnosis starts from, within the physical bounds of sensors and field.

Biases proportional to current or temperature, however large, are removed so that the fit can start. A sensor whose bias
follows a channel I reads y with |M (y - o - c I)|² = F². This is linear in the monomials of y and I, yᵀ Q y + 2 qᵀ y +
2 I sᵀ y + r I² + t I = 1 with Q = Mᵀ M but for a factor, so that c = -Q⁻¹ s, as the centre of the ellipsoid of Wu 2025
eq. 9 is -Q⁻¹ q. Where the attitude tells the field of one sensor, its readings are linear themselves: y = M Rᵀ h + o +
c I, in the products of the elements of M and of the field h of the world.

A wide prior keeps the fit from diverging. The rows m of a sensor's matrix D Λ describe its axes whatever way it is
mounted: their lengths are the scale factors, and the cosines between them the non-orthogonality. In the prior the
logarithms of the scale factors about their mean, these cosines and, without a scalar reference, the logarithm of the
intensity are normal, with the physical bounds as many deviations off as is certain: the prior does not matter where the
recording determines the parameters.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from math import log, sin, sqrt
from typing import Any

import numpy as np
from numpy.linalg import LinAlgError, norm
from numpy.typing import NDArray

from tam_calibration.core.least_squares import Normal
from tam_calibration.correction.acceptance import LARGEST_NON_ORTHOGONALITY, LARGEST_RATIO
from tam_calibration.effects.grades import CERTAIN, MOST, NEGLIGIBLE, NOTABLE
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.consistency import require_one_sphere
from tam_calibration.fit.ellipsoid import normalize, sphere_of_most
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.gap.regressors import products_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import FieldBounds
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, origin_of, to_degrees


def objection_to(errors: SensorErrors, intensity_T: float, field: FieldBounds) -> str | None:
    """Return in one clause which bound of sensors or field a calibration exceeds, or None.

    Parameters
    ----------
    errors : SensorErrors
        Of the sensors.
    intensity_T : float
        Of the field; without a scalar reference see ``sensed_intensity``.
    field : FieldBounds
        Bounds of it.
    """
    if not field.hold(intensity_T):
        return f"a field of {intensity_T * 1e6:.3g} µT, where {field.whose} has {field.range_uT}"
    scale = errors.scale_factor
    ratio = scale.max(axis=1) / scale.min(axis=1)
    worst = int(ratio.argmax())
    if ratio[worst] > LARGEST_RATIO:
        return f"scale factors of sensor {worst + 1} that differ by a factor of {ratio[worst]:.3g}"
    cosine = np.abs(_cosines(errors.matrix)).max(axis=1)
    worst = int(cosine.argmax())
    if cosine[worst] > sin(LARGEST_NON_ORTHOGONALITY):
        degrees = float(to_degrees(np.arcsin(min(cosine[worst], 1.0))))
        return f"axes of sensor {worst + 1} that stand {degrees:.0f} degrees off the right angle"
    return None


def sensed_intensity(errors: SensorErrors, intensity_T: float, field: FieldBounds) -> float:
    """Return the constant intensity in the unit of that sensor in which it is nearest to the usual field, tesla.

    Sensors may read in units of their own, but a fit that diverges scales all of them.

    Parameters
    ----------
    errors : SensorErrors
        Of K sensors.
    intensity_T : float
        Constant intensity of a fit without a scalar reference, tesla.
    field : FieldBounds
        Bounds with the usual field at their geometric mean.
    """
    return _most_usual(errors, intensity_T, field)[1]


def _most_usual(errors: SensorErrors, intensity_T: float, field: FieldBounds) -> tuple[int, float]:
    """Return the sensor whose unit makes the intensity most usual, and the intensity in that unit."""
    sensed_T = intensity_T * np.cbrt(np.linalg.det(errors.matrix))
    sensor = int(np.argmin(np.abs(np.log(sensed_T / field.middle_T))))
    return sensor, float(sensed_T[sensor])


def prior_at(errors: SensorErrors, intensity_T: float | None, field: FieldBounds) -> Normal:
    """Return the normal equations of the prior at some errors, in the columns of ``calibration_regressors``.

    Parameters
    ----------
    errors : SensorErrors
        Of K sensors.
    intensity_T : float, optional
        The constant that replaces a missing scalar reference; None where there is one.
    field : FieldBounds
        Bounds of it.
    """
    count = errors.sensor_count
    slopes = np.zeros((count, 6, count, 3, 4))
    for sensor, matrix in enumerate(errors.matrix):
        # The imaginary part of a complex step is the derivative to rounding (Squire and Trapp, SIAM Rev. 40, 1998).
        steps = _of_axes(matrix + 1e-30j * np.eye(9).reshape(3, 3, 3, 3))
        slopes[sensor, :, sensor, :, :3] = np.moveaxis(steps.imag / 1e-30, 2, 0)
    jacobian, deviate = slopes.reshape(6 * count, -1), _of_axes(errors.matrix).ravel()
    if intensity_T is not None:
        slope, one = _of_intensity(errors, intensity_T, field)
        jacobian, deviate = np.vstack([jacobian, slope]), np.append(deviate, one)
    return Normal(jacobian.T @ jacobian, -jacobian.T @ deviate, float(deviate @ deviate), len(deviate))


def _of_axes(matrix: NDArray[Any]) -> NDArray[Any]:
    """Return the deviates (..., 6) of sensors' axes from matrices (..., 3, 3), real or complex."""
    logarithm = np.log(_lengths(matrix))
    # The logarithms of two equally uncertain scale factors differ by √2 times the deviation of each.
    scale = sqrt(2) * CERTAIN / log(LARGEST_RATIO) * (logarithm - logarithm.mean(axis=-1, keepdims=True))
    # A cosine of 0.35 is beyond the limit of 15 degrees, so that the prior is wide.
    return np.concatenate([scale, CERTAIN / 0.35 * _cosines(matrix)], axis=-1)


def _lengths(matrix: NDArray[Any]) -> NDArray[Any]:
    """Return the lengths (..., 3) of the rows of matrices."""
    return np.asarray(np.sqrt(np.sum(matrix**2, axis=-1)))


def _cosines(matrix: NDArray[Any]) -> NDArray[Any]:
    """Return the cosines (..., 3) between the rows xy, xz and yz of matrices (..., 3, 3)."""
    unit = matrix / _lengths(matrix)[..., None]
    return np.asarray(np.sum(unit[..., [0, 0, 1], :] * unit[..., [1, 2, 2], :], axis=-1))


def _of_intensity(errors: SensorErrors, intensity_T: float, field: FieldBounds) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives (1, 12K) of the deviate of the intensity by the errors, and the deviate (1,)."""
    weight = 2 * CERTAIN / log(field.high_T / field.low_T)
    sensor, sensed_T = _most_usual(errors, intensity_T, field)
    slope = np.zeros((errors.sensor_count, 3, 4))
    # The logarithm of a determinant changes by the trace of the inverse times the change.
    slope[sensor, :, :3] = np.linalg.inv(errors.matrix[sensor]).T / 3
    deviate = weight * log(sensed_T / field.middle_T)
    return weight * slope.reshape(1, -1), np.array([deviate])


_Following = tuple[FloatArray, FloatArray]
"""Slopes (C, 3) of a sensor's bias over each channel, tesla, and residual energies (2,) without and with them."""


def without_channels(recording: Recording, is_oriented: NDArray[np.bool_] | None = None) -> Recording | None:
    """Return the recording without the biases that follow its channels; None where these explain little.

    Parameters
    ----------
    recording : Recording
        With filled channels.
    is_oriented : (N,) array of bool, optional
        Whether the attitude of a sample is known. With it the biases of one sensor are determined in a constant field
        of the world, else from the constant intensity of the field.
    """
    courses = _courses(recording)
    if not courses.size:
        return None
    try:
        if is_oriented is None:
            data = normalize(recording)
            points = np.moveaxis(data.points, 0, -1) * data.radius_T
            found = [_of_ellipsoid(of_sensor, courses) for of_sensor in points]
        else:
            found = [_in_world(recording.take(is_oriented), courses[is_oriented])]
    except InputError:
        return None
    without, within = np.sum([energies for _, energies in found], axis=0)
    if NOTABLE * without < within:
        return None
    added_T = np.stack([courses @ slopes_T for slopes_T, _ in found], axis=1)
    return replace(recording, readings_T=recording.readings_T - added_T)


def _in_world(recording: Recording, courses: FloatArray) -> _Following:
    """Return how the bias of one sensor in a constant field of the world follows courses (N, C)."""
    assert recording.attitude is not None
    products = products_of(recording.attitude)
    values, energies = _fit(products, courses, recording.readings_T[:, 0])
    return values[products.shape[1] :], energies


def _courses(recording: Recording) -> FloatArray:
    """Return the channels that change, (N, C), about their medians and in units of their standard deviations."""
    channels = [one for one in (recording.current_A, recording.temperature_C) if one is not None and np.ptp(one) > 0]
    courses = [(channel - np.median(channel)) / np.std(channel) for channel in channels]
    return np.array(courses).reshape(len(courses), recording.sample_count).T


def _of_ellipsoid(points_T: FloatArray, courses: FloatArray) -> _Following:
    """Return how the centre of the ellipsoid through the points (3, N) of a sensor follows courses (N, C).

    Raises
    ------
    InputError
        When the points lie on no ellipsoid.
    """
    unit_T = np.sqrt(np.mean(points_T**2))
    points, one = points_T / unit_T, np.ones(len(courses))
    monomials = ellipsoid.monomial_columns(points, one)[:9].T
    mixed = np.column_stack([2 * course * axis for course in courses.T for axis in points])
    squares = [course[:, None] * courses[:, first:] for first, course in enumerate(courses.T)]
    values, energies = _fit(monomials, np.column_stack([mixed, courses, *squares]), one)
    shape = ellipsoid.symmetric(values[:6])
    # Raises where the quadric is no ellipsoid.
    ellipsoid.square_root(shape)
    products = values[9 : 9 + mixed.shape[1]].reshape(-1, 3)
    return -unit_T * np.linalg.solve(shape, products.T).T, energies


def _fit(own: FloatArray, added: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares values of the columns own and added, and the residual energies by own and by all."""
    both = np.column_stack([own, added])
    values = np.linalg.lstsq(both, target, rcond=None)[0]
    alone = target - own @ np.linalg.lstsq(own, target, rcond=None)[0]
    return values, np.array([np.sum(alone**2), np.sum((target - both @ values) ** 2)])


def canonical_correlations(readings_T: FloatArray) -> FloatArray:
    """Return the canonical correlations (K, 3), the largest first, of sensors' readings (N, K, 3) with the first's.

    By the singular values between orthonormal bases of both (Björck and Golub 1973); spikes are clipped.
    """
    centered = readings_T - np.median(readings_T, axis=0)
    # A motion hardly goes farther than eight times the median distance from the median.
    size = 8.0 * np.median(np.abs(centered), axis=0)
    clipped = np.clip(centered, np.where(size > 0, -size, -np.inf), np.where(size > 0, size, np.inf))
    centered = np.swapaxes(clipped - clipped.mean(axis=0), 0, 1)
    basis = np.linalg.svd(centered, full_matrices=False)[0]
    return np.linalg.svd(np.swapaxes(basis, 1, 2) @ basis[0], compute_uv=False)


def significant_correlation(sample_count: int) -> float:
    """Return the correlation that noise of so many samples does not reach."""
    # White noise has one to two over the root of the samples, slow noise three times as much.
    return float(min(15.0 / np.sqrt(sample_count), MOST))


def starts(recording: Recording, array: Array) -> Iterator[tuple[SensorErrors, float]]:
    """Yield the starts of a fit: calibrations of the whole, mounted sensors without errors, and parts.

    A start has the errors of the sensors, and the constant intensity that replaces a missing scalar channel. A
    calibration of a part serves where something changed in the rest; sensors with mounting errors only serve where the
    readings alone determine no calibration.

    Parameters
    ----------
    recording : Recording
        Without outlying samples.
    array : Array
        With noise.
    """
    whole, *parts = _parts(recording.sample_count)
    yield from _calibrations(recording.take(whole), array)
    yield from _mounted(recording, array.field)
    for part in parts:
        yield from _calibrations(recording.take(part), array)


def _calibrations(recording: Recording, array: Array) -> Iterator[tuple[SensorErrors, float]]:
    """Yield the calibrations by maximum likelihood, of Gaussian and of robust errors, that there are."""
    for robust in (False, True):
        try:
            # A fit that has no solution may well divide by zero on its way to say so.
            with np.errstate(all="ignore"):
                fitted = maximum_likelihood(recording, array, robust=robust)
        except (InputError, Refused, LinAlgError):
            continue
        yield fitted.errors, fitted.intensity_T


def _mounted(recording: Recording, field: FieldBounds) -> Iterator[tuple[SensorErrors, float]]:
    """Yield sensors with bias, gain and mounting only, for each centre that the first sensor's sphere may have."""
    readings = recording.readings_T
    centered = readings - np.median(readings, axis=0)
    size = np.sqrt(np.mean(np.sum(centered**2, axis=2), axis=0))
    left, _, right = np.linalg.svd(np.einsum("nki,nj->kij", centered, centered[:, 0]))
    left[..., -1] *= np.linalg.det(left @ right)[:, None]
    turned = (size / size[0])[:, None, None] * (left @ right)
    turned[0] = np.eye(3)
    scalar_T = None if recording.scalar_T is None else float(np.nanmedian(recording.scalar_T))
    middle = np.median(readings, axis=0)
    for center, radius_T in _centers(readings[:, 0], scalar_T, field):
        intensity_T = radius_T if scalar_T is None else scalar_T
        bias = middle - turned @ (middle[0] - center)
        yield SensorErrors.from_matrix(turned * radius_T / intensity_T, bias), intensity_T


def _centers(
    readings_T: FloatArray, intensity_T: float | None, field: FieldBounds
) -> Iterator[tuple[FloatArray, float]]:
    """Yield centres and radii of spheres: the one through most readings, and two of the usual radius through a ring."""
    center, radius = sphere_of_most(readings_T)
    if field.hold(radius):
        yield center, radius
    middle = np.median(readings_T, axis=0)
    values, axes = np.linalg.eigh(np.cov(readings_T, rowvar=False))
    usual = field.middle_T if intensity_T is None else intensity_T
    height = np.sqrt(max(usual**2 - values.sum(), 0.0))
    for sign in (1, -1):
        yield middle + sign * height * axes[:, 0], usual


def outlying_samples(recording: Recording) -> NDArray[np.bool_]:
    """Return the samples (N,) in which a sensor's reading is an outlier; none where there are many."""
    length = norm(recording.readings_T, axis=2)
    # Bias and soft iron hardly double the length of a reading.
    outlying: NDArray[np.bool_] = (length > 4.0 * np.median(length, axis=0)).any(axis=1)
    return outlying if outlying.sum() <= NEGLIGIBLE * len(outlying) else np.zeros_like(outlying)


def steady_parts(recording: Recording) -> Iterator[slice | NDArray[np.intp]]:
    """Yield parts of a run that may be steady: halves and thirds, and the samples where a channel hardly changes.

    Parameters
    ----------
    recording : Recording
        With filled channels.
    """
    yield from _parts(recording.sample_count)[1:]
    for channel in (recording.temperature_C, recording.current_A):
        if channel is not None:
            yield _steadiest(channel)


def _steadiest(channel: FloatArray) -> NDArray[np.intp]:
    """Return those samples, in the order of time, in which a channel (N,) has the narrowest range."""
    order = np.argsort(channel)
    # A fifth of the samples: less than the pauses of a motor that runs 70 % of the time.
    count = int(0.2 * len(order))
    width = channel[order[count:]] - channel[order[: len(order) - count]]
    first = int(np.argmin(width))
    return np.sort(order[first : first + count])


def _parts(count: int) -> list[slice]:
    """Return the whole and, where something changed in the middle, its halves and thirds."""
    # Shorter parts seldom hold all attitudes.
    cuts = [np.linspace(0, count, parts + 1).astype(int) for parts in (1, 2, 3)]
    return [slice(int(low), int(high)) for cut in cuts for low, high in pairwise(cut)]


ENOUGH_SAMPLES = 8000
"""Samples of a long recording that refusal and search take at most; the final fit takes all."""


def open_parameters(recording: Recording, array: Array) -> str | None:
    """Return which parameters the attitudes leave open, in one sentence, or None.

    Parameters
    ----------
    recording : Recording
        Raw readings of K sensors, tesla, and those of the scalar magnetometer where there is one.
    array : Array
        Of these sensors; a noise that is not stated is estimated.
    """
    try:
        require_determined(recording, array)
    except (InputError, LinAlgError) as problem:
        return str(problem)
    except Refused:
        return None  # the readings contradict each other: effects may explain it
    return None


def without_calibration(recording: Recording, objection: str | None) -> str:
    """Return why no calibration is found within the bounds of sensors, and for which time.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    objection : str, optional
        Which bound the calibration that fits best exceeds.
    """
    try:
        require_one_sphere(recording)
    except Refused as problem:
        return str(problem)
    first, last = (one - origin_of(recording.time_span_s[0]) for one in recording.time_span_s)
    best = "" if objection is None else f": the one that fits best has {objection}"
    return f"no calibration that sensors can have fits the readings between {first:.1f} and {last:.1f} s{best}"
