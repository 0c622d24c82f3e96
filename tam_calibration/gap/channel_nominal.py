"""Removes biases proportional to current or temperature, however large, so that the nominal fit can start.

A sensor whose bias follows a channel I reads y with |M (y - o - c I)|² = F². This is linear in the monomials of y and
I, yᵀ Q y + 2 qᵀ y + 2 I sᵀ y + r I² + t I = 1 with Q = Mᵀ M but for a factor, so that c = -Q⁻¹ s, as the centre of
the ellipsoid of Wu 2025 eq. 9 is -Q⁻¹ q. Where the attitude tells the field of one sensor, its readings are linear
themselves: y = M Rᵀ h + o + c I, in the products of the elements of M and of the field h of the world.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.bias_jump import LEAST_FALL
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.scale import normalize
from tam_calibration.gap.attitude_nominal import products_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


def without_channels(recording: Recording) -> Recording | None:
    """Return the recording without the biases that follow its channels, determined from the intensity of the field.

    None where they do not explain most of the residual of an ellipsoid.

    Parameters
    ----------
    recording : Recording
        With filled channels, in a field of constant intensity.
    """
    data = normalize(recording)
    points = np.moveaxis(data.points, 0, -1) * data.radius_T
    return _without(recording, lambda courses: [_of_ellipsoid(of_sensor, courses) for of_sensor in points])


def without_channels_in_world(recording: Recording, is_oriented: NDArray[np.bool_]) -> Recording | None:
    """Return the recording of one sensor without the biases that follow its channels, determined with its attitudes.

    None where they do not explain most of the residual of a constant field of the world.

    Parameters
    ----------
    recording : Recording
        With filled channels.
    is_oriented : (N,) array of bool
        Whether the attitude of a sample is known.
    """
    oriented = recording.take(is_oriented)
    assert oriented.attitude is not None
    products = products_of(oriented.attitude)

    def following(courses: FloatArray) -> list[_Following]:
        readings_T = oriented.readings_T[:, 0]
        values, energies = _fit(products, courses[is_oriented], readings_T)
        return [_Following(values[products.shape[1] :], energies)]

    return _without(recording, following)


@dataclass(frozen=True, eq=False)
class _Following:
    """Slopes (C, 3) of a sensor's bias over each channel, tesla, and residual energies (2,) without and with them."""

    slopes_T: FloatArray
    energies: FloatArray


def _without(recording: Recording, following: Callable[[FloatArray], list[_Following]]) -> Recording | None:
    """Return the recording without the biases that follow its channels, where that lowers the residual energy much."""
    courses = _courses(recording)
    if not courses.size:
        return None
    try:
        found = following(courses)
    except InputError:
        return None
    without, within = np.sum([one.energies for one in found], axis=0)
    if without < LEAST_FALL * within:
        return None
    added_T = np.stack([courses @ one.slopes_T for one in found], axis=1)
    return replace(recording, readings_T=recording.readings_T - added_T)


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
    return _Following(-unit_T * np.linalg.solve(shape, products.T).T, energies)


def _fit(own: FloatArray, added: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the least-squares values of the columns own and added, and the residual energies by own and by all."""
    both = np.column_stack([own, added])
    values = np.linalg.lstsq(both, target, rcond=None)[0]
    alone = target - own @ np.linalg.lstsq(own, target, rcond=None)[0]
    return values, np.array([np.sum(alone**2), np.sum((target - both @ values) ** 2)])
