"""Physical bounds of sensors and field, and a wide prior that keeps a fit from diverging.

The rows m of a sensor's matrix D Λ describe its axes whatever way it is mounted: their lengths are the scale factors,
and the cosines between them the non-orthogonality. In the prior the logarithms of the scale factors about their mean,
these cosines and, without a scalar reference, the logarithm of the intensity are normal, with deviations so wide that
they do not matter where the recording determines the parameters itself.
"""

from itertools import combinations
from math import log, sin, sqrt

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Normal
from tam_calibration.correction.acceptance import LARGEST_NON_ORTHOGONALITY, LARGEST_RATIO
from tam_calibration.model.geomagnetic_field import FieldBounds
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, to_degrees

_DEVIATIONS = 3.5
"""Bounds in standard deviations of the prior: normal deviates exceed them once in two thousand times."""


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
    cosine = np.abs([_cosines(matrix) for matrix in errors.matrix]).max(axis=1)
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
    sensed = _sensed(errors, intensity_T)
    return float(sensed[_most_like(field, sensed)])


def _sensed(errors: SensorErrors, intensity_T: float) -> FloatArray:
    return np.asarray(intensity_T * np.cbrt(np.linalg.det(errors.matrix)))


def _most_like(field: FieldBounds, sensed_T: FloatArray) -> int:
    return int(np.argmin(np.abs(np.log(sensed_T / field.middle_T))))


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
    slopes, deviates = np.zeros((count, 6, count, 3, 4)), np.zeros((count, 6))
    for sensor, matrix in enumerate(errors.matrix):
        slopes[sensor, :, sensor, :, :3], deviates[sensor] = _of_axes(matrix)
    jacobian, deviate = slopes.reshape(6 * count, -1), deviates.ravel()
    if intensity_T is not None:
        slope, one = _of_intensity(errors, intensity_T, field)
        jacobian, deviate = np.vstack([jacobian, slope]), np.append(deviate, one)
    return Normal(jacobian.T @ jacobian, -jacobian.T @ deviate, float(deviate @ deviate), len(deviate))


def _of_axes(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives (6, 3, 3) of a sensor's deviates by its matrix, and the deviates (6,)."""
    length = norm(matrix, axis=1)
    unit = matrix / length[:, None]
    of_length = np.zeros((3, 3, 3))
    of_length[range(3), range(3)] = unit / length[:, None]
    of_cosine = np.zeros((3, 3, 3))
    cosine = _cosines(matrix)
    for index, (one, other) in enumerate(combinations(range(3), 2)):
        of_cosine[index, one] = (unit[other] - cosine[index] * unit[one]) / length[one]
        of_cosine[index, other] = (unit[one] - cosine[index] * unit[other]) / length[other]
    # The logarithms of two equally uncertain scale factors differ by √2 times the deviation of each.
    scale = sqrt(2) * _DEVIATIONS / log(LARGEST_RATIO)
    # A cosine of 0.35 is beyond the limit of 15 degrees, so that the prior is wide.
    angle = _DEVIATIONS / 0.35
    logarithm = np.log(length)
    deviates = np.concatenate([scale * (logarithm - logarithm.mean()), angle * cosine])
    return np.concatenate([scale * (of_length - of_length.mean(axis=0)), angle * of_cosine]), deviates


def _cosines(matrix: FloatArray) -> FloatArray:
    """Return the cosines (3,) between the rows xy, xz and yz of a matrix."""
    unit = matrix / norm(matrix, axis=1)[:, None]
    return np.array([unit[one] @ unit[other] for one, other in combinations(range(3), 2)])


def _of_intensity(errors: SensorErrors, intensity_T: float, field: FieldBounds) -> tuple[FloatArray, FloatArray]:
    """Return the derivatives (1, 12K) of the deviate of the intensity by the errors, and the deviate (1,)."""
    weight = 2 * _DEVIATIONS / log(field.high_T / field.low_T)
    sensed = _sensed(errors, intensity_T)
    sensor = _most_like(field, sensed)
    slope = np.zeros((errors.sensor_count, 3, 4))
    # The logarithm of a determinant changes by the trace of the inverse times the change.
    slope[sensor, :, :3] = np.linalg.inv(errors.matrix[sensor]).T / 3
    deviate = weight * log(sensed[sensor] / field.middle_T)
    return weight * slope.reshape(1, -1), np.array([deviate])
