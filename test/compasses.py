"""Attitudes that take their heading from the readings of a magnetometer, and turns on which they are recorded."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

WORLD_T = np.array([0.0, 19e-6, -45e-6])
RATE_HZ = 10.0
ERRORS = SensorErrors(
    1 + 0.01 * np.array([[1.0, -1.2, 0.5], [-0.8, 0.4, 0.9], [0.3, 0.7, -1.1], [-0.6, -0.2, 0.4]]),
    np.radians([[0.2, -0.1, 0.3], [0.1, 0.2, -0.2], [-0.3, 0.1, 0.1], [0.2, 0.3, -0.1]]),
    1e-9 * np.array([[300.0, -250, 240], [180, -220, 310], [-150, -330, 200], [260, -140, -270]]),
    np.radians([[0.0, 0.0, 0.0], [0.3, -0.2, 0.4], [-0.1, 0.4, 0.2], [0.2, 0.1, -0.3]]),
)
CROSS = Array.cross(0.5, 1e-9, 1e-10)


def circles(tilt_deg=20.0, count=1200, period_s=30.0):
    """Return full circles of yaw with swings of pitch and roll."""
    phase = 2 * np.pi * np.arange(count) / RATE_HZ / period_s
    swing = np.radians(tilt_deg) * np.sin(np.outer(phase, [1.618, 2.618]))
    return Rotation.from_euler("ZYX", np.column_stack([phase, swing]))


def swings(limit_deg=5.0, count=1200, period_s=30.0):
    """Return swings about all three axes."""
    phase = 2 * np.pi * np.arange(count) / RATE_HZ / period_s
    return Rotation.from_euler("ZYX", np.radians(limit_deg) * np.sin(np.outer(phase, [1.0, 1.618, 2.618])))


def recorded(turns, seed, errors=ERRORS, array=CROSS, attitude=None):
    """Return what the sensors read, with the array's noise and an attitude."""
    rng = np.random.default_rng(seed)
    field_T = turns.inv().apply(WORLD_T)
    readings_T = errors.distort(field_T) + rng.normal(0, array.vector_noise_T[0], (len(turns), len(errors.bias_T), 3))
    scalar_T = np.linalg.norm(field_T, axis=1) + rng.normal(0, array.scalar_noise_T, len(turns))
    quaternions = None if attitude is None else attitude.as_quat()
    return Recording(np.arange(len(turns)) / RATE_HZ, readings_T, scalar_T, attitude=quaternions)


def off_by(turns, deg, seed, lasting=1):
    """Return attitudes in error about each axis by so many degrees, the same for so many samples at a time."""
    error = np.random.default_rng(seed).normal(0, np.radians(deg), (-(-len(turns) // lasting), 3))
    return turns * Rotation.from_rotvec(np.repeat(error, lasting, axis=0)[: len(turns)])


def with_compass(recording, turns, seed, tilt_deg=0.1, sensor=0, filter_s=0.0):
    """Return the recording with the attitude of an AHRS of one of its sensors, level by gravity, its heading raw."""
    _, pitch, roll = off_by(turns, tilt_deg, seed).as_euler("ZYX").T
    level = Rotation.from_euler("YX", np.column_stack([pitch, roll])).apply(recording.readings_T[:, sensor])
    yaw = turns.as_euler("ZYX")[:, 0]
    wrong = np.arctan2(WORLD_T[1], WORLD_T[0]) - np.arctan2(level[:, 1], level[:, 0]) - yaw
    wrong = (wrong + np.pi) % (2 * np.pi) - np.pi
    kept = np.exp(-1 / (filter_s * RATE_HZ)) if filter_s else 0.0
    for index in range(1, len(wrong)):
        wrong[index] = kept * wrong[index - 1] + (1 - kept) * wrong[index]
    attitude = Rotation.from_euler("ZYX", np.column_stack([yaw + wrong, pitch, roll]))
    return replace(recording, attitude=attitude.as_quat())


def worst(calibration, errors=ERRORS):
    """Return by how many of its standard errors the worst parameter is off."""
    free = calibration.standard_errors > 0
    return np.max(np.abs(calibration.errors.to_vector() - errors.to_vector())[free] / calibration.standard_errors[free])
