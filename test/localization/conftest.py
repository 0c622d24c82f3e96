import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.sensor_errors import SensorErrors, noise_floor

EARTH_T = np.array([1e-6, 2e-5, -4.5e-5])


def outputs_of(source, points_m=(0, 0, 0)):
    """Return the eight outputs of an array of no extent at a place."""
    point = np.asarray(points_m, dtype=float)
    return np.concatenate([source.field_T(point), source.gradient_T_per_m(point)[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]])


def calibration_of(array):
    """Return the calibration of an array without errors, known exactly."""
    errors = SensorErrors.none(array.sensor_count)
    floor = noise_floor(errors, array, 1e-10)
    exact = np.zeros((errors.to_vector().size,) * 2)
    return Calibration(
        "maximum_likelihood", array, False, errors, exact, True, 48e-6, floor, floor, floor, 100, (0.0, 1.0), 1.0
    )
