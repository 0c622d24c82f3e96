"""What recorded attitude adds to a fit: the turn of the common frame, and the gradient of the ambient field."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import AmbientGradientEstimate
from tam_calibration.effects.ambient_gradient import require_attitude, without_gradient
from tam_calibration.fit.channel_maps import Turning
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees

FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded. It was found from the uniform field, "
    "which is constant in the world while the array turns."
)


def find_turn(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return the rotation X with which the fields to_world X field are nearest to one vector w.

    Parameters
    ----------
    field : (N, 3) array
        Uniform field b in a frame that is fixed to the array, in a unit in which it is of order one.
    to_world : (N, 3, 3) array
        Recorded attitude Q of each sample: rotation matrix from the array frame to the world.

    Returns
    -------
    (3, 3) array
        From the frame of the field to the one whose attitude was recorded.

    Raises
    ------
    InputError
        When the array was not turned about two axes.
    """
    turns = _still_turns(field, to_world)
    if turns.shape[1] != 1:
        raise InputError("the attitude does not determine the frame: turn the array about two axes at least")
    return _nearest_rotation(turns.reshape(3, 3))


def likely_turn(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return such a rotation also where the array was hardly turned: of all that agree, one near to no turn.

    Parameters
    ----------
    field, to_world : array
        As of ``find_turn``.
    """
    turns = _still_turns(field, to_world)
    return _nearest_rotation((turns if turns.shape[1] == 1 else turns @ (turns.T @ np.eye(3).ravel())).reshape(3, 3))


def _still_turns(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return the (9, M) turns X with which the field stands still in the world, M ≥ 1, the best first.

    The sum of |X b - Qᵀ w|² is quadratic in X and w together; w is eliminated, and the best X of unit norm is an
    eigenvector.
    """
    mixed = np.einsum("naj,ni->jia", to_world, field).reshape(9, 3)
    residuals = np.kron(np.eye(3), field.T @ field) - mixed @ mixed.T / len(field)
    values, vectors = np.linalg.eigh(residuals)
    # 1e-3: how far the second best turn must be from the field standing still, as part of the field's square.
    return vectors[:, : max(1, int(np.searchsorted(values, 1e-3 * len(field))))]


def _nearest_rotation(matrix: FloatArray) -> FloatArray:
    left, _, right = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    return np.asarray(left @ right)


_OPEN = 1e-12
"""Information of a direction, that of each unknown alone one, up to which it is open: rounding leaves as much."""


def aligned(attitude: FloatArray, field: FloatArray) -> FloatArray:
    """Return attitudes that agree with the field, which all but stands still in the world.

    Parameters
    ----------
    attitude : (N, 4) array
        As recorded: turned against the array by a fixed angle, and in error from sample to sample.
    field : (N, 3) array
        At the centre in the array frame, in any unit.

    Returns
    -------
    (N, 4) array
        Without the fixed turn, and with what is left of each error about the field alone, which cannot be seen.

    Raises
    ------
    InputError
        When the array was not turned about two axes, or the attitudes are not those of the readings.
    """
    from scipy.spatial.transform import Rotation

    recorded = Rotation.from_quat(attitude)
    field = field / norm(field, axis=1, keepdims=True)
    to_world = recorded * Rotation.from_matrix(find_turn(field, recorded.as_matrix()))
    seen = to_world.apply(field)
    mean = seen.mean(axis=0) / norm(seen.mean(axis=0))
    back = turns_between(seen, mean)
    angle = norm(back, axis=1)
    if reason := strayed(float(np.median(angle))):
        raise InputError(reason)
    return np.asarray((Rotation.from_rotvec(back) * to_world).as_quat())


def strayed(angle: float) -> str:
    """Return why attitudes in whose world the field turns by an angle, radians, are wrong; nothing if it is small."""
    # from_degrees(10.0): of the field in the world of the attitude; more is not noise of the attitude.
    if angle < from_degrees(10.0):
        return ""
    return (
        f"the field of the readings is not constant in the world of the attitude but turns by "
        f"{to_degrees(angle):.0f}°. Attitude must be the turn from the array to the world, x y z w, at the time of the "
        "sample"
    )


def turns_between(seen: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the shortest rotation vectors (N, 3) that turn unit vectors (N, 3) into another (3,)."""
    axis = np.cross(seen, direction)
    sine = norm(axis, axis=1)
    return np.asarray(axis * (np.arctan2(sine, seen @ direction) / np.maximum(sine, np.finfo(float).tiny))[:, None])


def across_of(along: FloatArray) -> FloatArray:
    """Return two unit vectors (N, 2, 3) across unit vectors (N, 3), right-handed with them as the third."""
    axis = np.eye(3)[np.abs(along).argmin(axis=1)]
    first = np.cross(along, axis)
    first /= norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(along, first)], axis=1)


def turning_of(recording: Recording, array: Array, field: FloatArray) -> Turning:
    """Return how a recording with attitude turned the array.

    Parameters
    ----------
    recording : Recording
        With an attitude in every sample.
    array : Array
        Positions of the sensors and of the scalar magnetometer.
    field : (N, 3) array
        At the centre in the frame of the array, in any unit: the attitudes are aligned with it.
    """
    assert recording.attitude is not None
    at_center = np.zeros(3)
    scalar_position = at_center if array.scalar_position_m is None else array.scalar_position_m
    return Turning(aligned(recording.attitude, field), array.positions_m, scalar_position)


def as_if_uniform(
    source: SampleSource, errors: SensorErrors, array: Array, gradient: AmbientGradientEstimate | None
) -> SampleSource:
    """Return samples as they would be in a uniform field, their attitudes aligned; themselves without a gradient.

    Parameters
    ----------
    source : SampleSource
        Raw readings.
    errors : SensorErrors
        Of the sensors, as fitted.
    array : Array
        Positions of the sensors and of the scalar magnetometer.
    gradient : AmbientGradientEstimate, optional
        What was fitted of the gradient in the world; None for a uniform field.

    Raises
    ------
    InputError
        When there is a gradient and the recording has no attitude that belongs to it.
    """
    if gradient is None:
        return source
    known = require_attitude(source.whole())
    assert known.attitude is not None
    attitude = aligned(known.attitude, errors.restore(known.readings_T).mean(axis=1))
    return without_gradient(replace(known, attitude=attitude), errors, array, gradient.tensor_T_per_m)


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


def gradient_of(components: FloatArray, covariance: FloatArray, unit_T: float) -> AmbientGradientEstimate:
    """Return the tensor of fitted components of the gradient, with its standard errors.

    Parameters
    ----------
    components : (5,) array
        xx, xy, xz, yy, yz in the world, per metre in units of ``unit_T``.
    covariance : (5, 5) array
        Of the components, in the square of their unit.
    unit_T : float
        Unit of field of the components, tesla.
    """
    basis = UNIT_TENSORS.reshape(5, 9)
    variance = np.einsum("pi,pq,qi->i", basis, covariance, basis).reshape(3, 3)
    return AmbientGradientEstimate(unit_T * np.tensordot(components, UNIT_TENSORS, 1), unit_T * np.sqrt(variance))


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
    if not (np.isfinite(variance).all() and lever_m * np.sqrt(variance.max()) <= vector_noise.max()):
        raise InputError(
            "the attitudes do not tell an ambient gradient from the errors of the sensors: turn the array about "
            "several axes and in as many attitudes as it takes, or calibrate where the field is uniform"
        )
