"""Recordings of one full circle with small swings, and a gyroscope."""

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees

RATE_HZ, COUNT = 10.0, 3000
GYROSCOPE = Gyroscope(from_degrees(4.5e-3), from_degrees(0.1))
WORLD_T = 50e-6 * np.array([0.0, np.cos(1.08), -np.sin(1.08)])


def attitude_at(time_s, period_s):
    """Return one full circle with swings of 5°."""
    yaw, swing = 2 * np.pi * time_s / period_s, from_degrees(5.0)
    pitch, roll = swing * np.sin(2 * np.pi * time_s / 15), swing * np.sin(2 * np.pi * time_s / 20 + 0.4)
    return Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll]))


def made(sensors=1, seed=1, count=COUNT, has_scalar=True, noise=1.0, added_T=0.0):
    """Return a recording of one full circle with swings of 5°, its array, and the true errors.

    A field that is added in the array frame, (count, 3), acts on all sensors and the scalar.
    """
    rng, time_s = np.random.default_rng(seed), np.arange(count) / RATE_HZ
    at, before, after = (attitude_at(time_s + moment_s, time_s[-1]) for moment_s in (0.0, -1e-4, 1e-4))
    field, rates = at.inv().apply(WORLD_T) + added_T, (before.inv() * after).as_rotvec() / 2e-4
    spread = np.repeat([0.02, 0.005, 30e-9, 0.005], 3)
    errors = SensorErrors.from_vector(
        np.repeat([1.0, 0.0], [3, 9]) + spread * rng.normal(size=(sensors, 12)) * (np.arange(12) < 9)
    )
    array = Array(Array.cross(0.5).positions_m[:sensors], 1e-9, 1e-10, gyroscope=GYROSCOPE)
    readings = errors.distort(field)
    recording = Recording(
        time_s,
        readings + rng.normal(0, noise * 1e-9, readings.shape),
        np.linalg.norm(field, axis=1) + rng.normal(0, 1e-10, count) if has_scalar else None,
        angular_velocity_rad_s=GYROSCOPE.readings(time_s, rates, rng) if noise else rates,
    )
    return recording, array, errors
