"""Arrays with tolerances, errors that these may have, and turns of a vehicle that tell little of them."""

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import ChangeRates, Tolerances
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation.conditions import Manoeuvre

WIDE = Tolerances(0.05, np.radians(2), 3e-6, np.radians(2))
"""What a vehicle's iron adds to a chip: over such errors lengths bend by a hundred times the noise."""

FINE = Tolerances(0.005, np.radians(0.5), 50e-9, np.radians(1))
"""A fluxgate's data sheet, and a mounting by eye."""

WORLD_T = np.array([3e-6, 18e-6, -46e-6])
NOISE_T = 1e-9


def array_of(tolerances, sensors, noise_T=NOISE_T):
    """Return an array with tolerances, of one sensor or the cross; a noise of None is not stated."""
    positions = np.zeros((1, 3)) if sensors == 1 else Array.cross(0.5).positions_m
    noise = (None, None) if noise_T is None else (np.full(sensors, noise_T), noise_T / 10)
    return Array(positions, *noise, tolerances=tolerances, change_rates=ChangeRates(*np.zeros(8)))


def drawn(tolerances, sensors, rng):
    """Return errors that the tolerances may have."""
    errors = rng.normal(size=(sensors, 12)) * np.sqrt(tolerances.variances())
    errors[:, :3] += 1
    return SensorErrors.from_vector(errors)


def turned(errors, tilt_deg, rng, start_s=0.0, count=300):
    """Return full circles with swings of pitch and roll, read with white noise."""
    limit, time_s = np.radians(tilt_deg), 0.2 * np.arange(count)
    to_world = Rotation.from_quat(Manoeuvre(limit, limit, 60.0).attitudes(time_s + rng.uniform(0, 30), rng))
    field = to_world.inv().apply(WORLD_T)
    readings = errors.distort(field)
    scalar = np.linalg.norm(field, axis=1) + rng.normal(0, NOISE_T / 10, count)
    return Recording(start_s + time_s, readings + rng.normal(0, NOISE_T, readings.shape), scalar)
