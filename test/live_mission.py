"""A simulated vehicle for the tests of the live calibration: a full turn ashore, then a dive within ±10°."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import prior_of
from tam_calibration.model.data_sheet import ChangeRates
from tam_calibration.model.recording import Recording

WORLD_T = np.array([12e-6, 18e-6, -45e-6])
UNCHANGING = ChangeRates(*[0.0] * 8)


def samples(errors, attitudes, array, generator, time_s):
    """Return rows (N, 3K + 3) as `Live.add` takes them."""
    field = attitudes.inv().apply(WORLD_T)
    readings = errors.distort(field) + array.vector_noise_T[:, None] * generator.normal(
        size=(len(field), *array.positions_m.shape)
    )
    scalar = np.linalg.norm(WORLD_T) + array.scalar_noise_T * generator.normal(size=len(field))
    return np.column_stack([time_s, readings.reshape(len(field), -1), scalar, np.full(len(field), np.nan)])


def _dived(time_s, tilt):
    angles = [2 * np.pi * time_s / 90, tilt * np.sin(0.86 * time_s), tilt * np.sin(1.23 * time_s)]
    return Rotation.from_euler("ZYX", np.stack(angles, axis=1))


def dive(errors, array, generator, time_s, tilt=np.pi / 18):
    """Return the rows of a vehicle that turns once in 90 s, with so much of pitch and roll, radians."""
    return samples(errors, _dived(time_s, tilt), array, generator, time_s)


def rates_of_dive(gyroscope, generator, time_s, tilt=np.pi / 18):
    """Return what a gyroscope reads meanwhile, (N, 3), rad/s."""
    before, after = _dived(time_s - 1e-4, tilt), _dived(time_s + 1e-4, tilt)
    return gyroscope.readings(time_s, (before.inv() * after).as_rotvec() / 2e-4, generator)


def recording_of(rows):
    """Return the recording of rows."""
    return Recording(rows[:, 0], rows[:, 1:-2].reshape(len(rows), -1, 3), rows[:, -2])


def ashore(errors, array, generator, rates=None):
    """Return the prior that a turn through 3000 attitudes makes."""
    rows = samples(errors, Rotation.random(3000, random_state=generator), array, generator, np.arange(3000) / 100)
    calibration = maximum_likelihood(recording_of(rows), array)
    return prior_of(calibration, None, None, rates)


def moved(errors, sensor, **changes):
    """Return errors of which some of a sensor (from 1) are changed by rows of three."""
    kinds = {name: getattr(errors, name).copy() for name in changes}
    for name, change in changes.items():
        kinds[name][sensor - 1] += change
    return replace(errors, **kinds)
