"""What errors of a calibration, and of the sensors' places, make of the readings that it has corrected.

A corrected reading is b̂ = M̂⁻¹ (y - ô). With errors dM and do of matrix and bias it is b - M⁻¹ (dM b + do) to first
order: linear in the parameters, whose covariance the calibration holds. So a few unknowns of standard deviation one say
all that may be wrong with the readings of a recording, at most as many as there are parameters.
"""

import numpy as np

from tam_calibration.core.least_squares import root_of
from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.units import FloatArray

_SMALLEST = 1e-3
"""Effect on all readings, over the stated noise, below which an error is left out: beside a noise that is 30 times
smaller it adds a thousandth to χ²."""

PLACE_ERROR_M = 1e-3
"""Standard deviation of each coordinate of a sensor's place, metres, where readings show that places are not exact: of
a frame that was measured with a rule."""


def places_of(tensors: FloatArray, sensor_count: int) -> FloatArray:
    """Return the derivatives (N, 3 K, 3 K) of readings by the places of the sensors, T/m.

    Parameters
    ----------
    tensors : (N, 3, 3) array
        Gradient at each sample, T/m, taken as the same at all sensors.
    sensor_count : int
        K.
    """
    places = np.einsum("kl,nij->nkilj", np.eye(sensor_count), tensors)
    return np.asarray(places.reshape(len(tensors), 3 * sensor_count, 3 * sensor_count))


def errors_of(calibration: Calibration, fields_T: FloatArray, *, is_alternating: bool = False) -> FloatArray:
    """Return the derivatives (N, 3 K, Q) of corrected readings by errors of the calibration, tesla.

    Parameters
    ----------
    calibration : Calibration
        With a covariance; without one there are no errors.
    fields_T : (N, K, 3) array
        Corrected readings, array frame, tesla.
    is_alternating : bool
        Whether they are amplitudes, which a bias does not change.

    Returns
    -------
    (N, 3 K, Q) array
        For Q independent errors of mean zero and standard deviation one, Q at most 12 K.
    """
    shape = (len(fields_T), 3 * calibration.errors.sensor_count)
    if calibration.covariance is None:
        return np.zeros((*shape, 0))
    full = np.pad(fields_T, ((0, 0), (0, 0), (0, 1)), constant_values=0.0 if is_alternating else 1.0)
    by_parameter = -calibration.errors.inverse[:, None] @ np.moveaxis(calibration.errors.jacobian(), 2, 1)
    root = root_of(calibration.covariance).reshape(calibration.errors.sensor_count, 12, -1)
    errors = np.einsum("nkd,kdip,kpq->nkiq", full, by_parameter, root, optimize=True).reshape(*shape, -1)
    seen = errors / np.repeat(calibration.array.vector_noise_T, 3)[:, None]
    squares, vectors = np.linalg.eigh(np.einsum("njp,njq->pq", seen, seen, optimize=True))
    return np.asarray(errors @ vectors[:, squares > _SMALLEST**2])
