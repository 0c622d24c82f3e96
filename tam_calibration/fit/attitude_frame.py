"""The turn of a calibration's frame against the array, which a uniform field hides and recorded attitude shows.

In the world the field stands still while the array turns: attitude and calibrated field agree on it in one frame only.
"""

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.recording import Recording
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.units import FloatArray

FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded. It was found from the uniform field, "
    "which stands still in the world while the array turns."
)

_SMALLEST_SHARE = 1e-3


def into_array_frame(errors: SensorErrors, recording: Recording) -> SensorErrors:
    """Return errors with their common frame turned into the one whose attitude was recorded.

    Parameters
    ----------
    errors : SensorErrors
        In any frame that is fixed to the array, such as that of sensor 1.
    recording : Recording
        Samples in a uniform field with attitude.

    Returns
    -------
    SensorErrors
        The misalignment of sensor 1 is no longer zero.

    Raises
    ------
    InputError
        When the recording has no attitude, or the array was not turned about two axes.
    """
    from scipy.spatial.transform import Rotation

    if recording.attitude is None:
        raise InputError("the recording has no attitude: without it the frame of the array is not to be found")
    field = errors.restore(recording.readings_T).mean(axis=1)
    field = field / np.sqrt(np.mean(np.sum(field**2, axis=1)))
    to_world = Rotation.from_quat(recording.attitude).as_matrix()
    turn = find_turn(field, to_world)
    return SensorErrors.from_matrix(errors.matrix @ turn.T, errors.bias_T)


def find_turn(field: FloatArray, to_world: FloatArray) -> FloatArray:
    """Return the rotation X (3, 3) with which to_world X field (N, 3) is nearest to one vector w; field of order one.

    The sum of |X b - Qᵀ w|² is quadratic in X and w together; w is eliminated, and the best X of unit norm is an
    eigenvector, the nearest rotation to which is taken.
    """
    mixed = np.einsum("naj,ni->jia", to_world, field).reshape(9, 3)
    misfit = np.kron(np.eye(3), field.T @ field) - mixed @ mixed.T / len(field)
    values, vectors = np.linalg.eigh(misfit)
    if values[1] < _SMALLEST_SHARE * len(field):
        raise InputError("the attitude does not determine the frame: turn the array about two axes at least")
    found = vectors[:, 0].reshape(3, 3)
    left, _, right = np.linalg.svd(found * np.sign(np.linalg.det(found)))
    turn: FloatArray = left @ right
    return turn
