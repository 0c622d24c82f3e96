"""The nominal fit: the calibration that a diagnosis starts from, whatever else is in the recording."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.array import Array
from tam_calibration.effects.bias_jump import BiasJump
from tam_calibration.effects.fitted import FittedEffect
from tam_calibration.effects.situation import Situation
from tam_calibration.errors import SensorErrors
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.noise import complete_noise
from tam_calibration.fit.scale import sphere_of_most
from tam_calibration.gap.design import update
from tam_calibration.problems import InputError, Refused
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_LEAST_RADIUS = 0.1
_SURE_HAND = 1e-3
_WILD, _MOST_WILD = 4.0, 0.02
"""Times the median length from which a reading is wild, and the part of the samples up to which these are few."""


def start(recording: Recording, array: Array) -> tuple[Array, SensorErrors, float]:
    """Return the array with its noise, the errors of a first fit and the intensity that stands for a scalar channel.

    Where no calibration fits the whole recording, that of a part of it is taken; where none fits any part, the
    spheres on which most readings lie.

    Raises
    ------
    InputError
        When a sensor is left-handed.
    """
    noisy, _ = complete_noise(array, recording)
    for part in _parts(recording.sample_count):
        for robust in (False, True):
            try:
                # A fit that has no solution may well divide by zero on its way to say so.
                with np.errstate(all="ignore"):
                    fitted = maximum_likelihood(recording.take(part), array, robust=robust)
            except (InputError, Refused):
                continue
            if array.vector_noise_T is None:
                noisy = replace(noisy, vector_noise_T=fitted.array.vector_noise_T)
            return noisy, fitted.errors, fitted.intensity_T
    _check_hands(recording)
    return noisy, *_spheres(recording)


def _check_hands(recording: Recording) -> None:
    """Check that all sensors turn the same way round as the first."""
    centered = recording.readings_T - recording.readings_T.mean(axis=0)
    scatter = np.einsum("nki,nj->kij", centered, centered[:, 0])
    determinant = np.linalg.det(scatter / norm(scatter, axis=(1, 2), keepdims=True))
    for sensor, value in enumerate(determinant):
        if value < -_SURE_HAND:
            raise InputError(f"sensor {sensor + 1} has left-handed or dependent axes: check their order and signs")


def _spheres(recording: Recording) -> tuple[SensorErrors, float]:
    """Return the biases and scale factors of the spheres on which most readings lie, and their intensity."""
    found = [sphere_of_most(readings) for readings in np.swapaxes(recording.readings_T, 0, 1)]
    radius = np.array([radius for _, radius in found])
    mean = float(radius.mean())
    intensity = mean if recording.scalar_T is None else float(np.nanmean(recording.scalar_T))
    scale = np.maximum(radius, _LEAST_RADIUS * mean) / intensity
    matrix = scale[:, None, None] * np.eye(3)
    return SensorErrors.from_matrix(matrix, np.array([center for center, _ in found])), intensity


def wild_samples(recording: Recording) -> NDArray[np.bool_]:
    """Return the samples (N,) in which a sensor reads far beyond what it mostly does, where these are few."""
    length = norm(recording.readings_T, axis=2)
    wild: NDArray[np.bool_] = (length > _WILD * np.median(length, axis=0)).any(axis=1)
    return wild if wild.sum() <= _MOST_WILD * len(wild) else np.zeros_like(wild)


def without_jump(recording: Recording, jump: FittedEffect) -> Recording:
    """Return the recording without a jump that is known beforehand."""
    none = SensorErrors.none(recording.sensor_count)
    place = Array(np.zeros((recording.sensor_count, 3)))
    situation = Situation(recording.time_s, recording.readings_T[:, 0], none, place)
    added = BiasJump().signal(situation, jump)[:, :-1].reshape(recording.readings_T.shape)
    return replace(recording, readings_T=recording.readings_T - added)


def _parts(count: int) -> list[slice]:
    """Return the whole and, where something changed in the middle, its halves and thirds."""
    cuts = [np.linspace(0, count, parts + 1).astype(int) for parts in (1, 2, 3)]
    return [slice(int(low), int(high)) for cut in cuts for low, high in pairwise(cut)]


def stepped(errors: SensorErrors, step: FloatArray, unit_T: float) -> SensorErrors:
    """Return errors after a step of ``calibration_design``, in the frame of the first sensor."""
    matrix, bias = update(errors, step, unit_T)
    if not (np.isfinite(matrix).all() and np.isfinite(bias).all()):
        raise Refused("the nominal fit does not settle: the readings do not fit one calibration")
    first = SensorErrors.from_matrix(matrix, bias).rotation[0]
    return SensorErrors.from_matrix(matrix @ first.T, bias)
