"""The gradient of the ambient field as a nuisance of the joint fit: what attitudes tell of it, and how well."""

import numpy as np
from numpy.linalg import norm

from tam_calibration.array import Array
from tam_calibration.calibration import AmbientGradient
from tam_calibration.effects.ambient_gradient import BASIS
from tam_calibration.fit.channels import Turning
from tam_calibration.problems import InputError
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_OPEN = 1e-12


def turning_of(recording: Recording, array: Array) -> Turning:
    """Return how a recording with attitude turned the array."""
    assert recording.attitude is not None
    at_center = np.zeros(3)
    scalar_position = at_center if array.scalar_position_m is None else array.scalar_position_m
    return Turning(recording.attitude, array.positions_m, scalar_position)


def marginal_information(information: FloatArray, free: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return the information of the rows with the gradient unknown, and the covariance of the gradient.

    Parameters
    ----------
    information : (12 K + 5, 12 K + 5) array
        Of rows and gradient together.
    free : (12 K,) array of bool
        Rows that are fitted; the others are known.

    Returns
    -------
    (12 K, 12 K) array
        Of all rows.
    (5, 5) array
        Infinite where the data leave the gradient open.
    """
    count = len(free)
    rows, cross, own = information[:count, :count], information[:count, count:], information[count:, count:]
    scale = 1 / np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    scaled = information * np.outer(scale, scale)
    kept = np.flatnonzero(free)
    left = (
        scaled[count:, count:]
        - scaled[count:, kept] @ np.linalg.lstsq(scaled[np.ix_(kept, kept)], scaled[kept, count:], rcond=_OPEN)[0]
    )
    values, vectors = np.linalg.eigh(left)
    if values[0] <= _OPEN:
        return rows, np.full((5, 5), np.inf)
    inverse = (vectors / values) @ vectors.T
    return rows - cross @ np.linalg.solve(own, cross.T), inverse * np.outer(scale[count:], scale[count:])


def gradient_of(components: FloatArray, covariance: FloatArray, unit_T: float) -> AmbientGradient:
    """Return the tensor of fitted components (5,) per metre, in units of a field, with its standard errors."""
    basis = BASIS.reshape(5, 9)
    variance = np.einsum("pi,pq,qi->i", basis, covariance, basis).reshape(3, 3)
    return AmbientGradient(unit_T * np.tensordot(components, BASIS, 1), unit_T * np.sqrt(variance))


def require_gradient_determined(covariance: FloatArray, vector_noise: FloatArray, array: Array) -> None:
    """Check that the recording tells more of the gradient than a calibrated array would in a single sample.

    Parameters
    ----------
    covariance : (5, 5) array
        Of the gradient's components, per square metre.
    vector_noise : (K,) array
        In the same unit of field.
    array : Array
        Its longest lever turns a gradient into a field.

    Raises
    ------
    InputError
        When it does not.
    """
    variance = np.append(np.diag(covariance), covariance[0, 0] + 2 * covariance[0, 3] + covariance[3, 3])
    lever_m = norm(array.positions_m, axis=1).max()
    if not lever_m * np.sqrt(variance.max()) <= vector_noise.max():
        raise InputError(
            "the attitudes do not tell an ambient gradient from the errors of the sensors: turn the array about "
            "several axes and in as many attitudes as it takes, or calibrate where the field is uniform"
        )
