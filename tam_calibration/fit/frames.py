"""The errors of sensors in another common frame, with their covariance."""

import numpy as np
from numpy.linalg import inv

from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_CROSS = np.swapaxes(np.cross(np.eye(3)[:, None], np.eye(3)[None]), 1, 2)
"""(3, 3, 3) matrices [e]× of the unit vectors."""


def turned(
    errors: SensorErrors, rotation: FloatArray, orientation: FloatArray | None = None
) -> tuple[SensorErrors, FloatArray]:
    """Return errors in a frame from which a rotation X leads to that of the errors given, and their derivative.

    A further turn δ, (1 + [δ]×) X, changes the matrices M X by M [δ]× X.

    Parameters
    ----------
    errors : SensorErrors
        Of K sensors, with matrices M.
    rotation : (3, 3) array
        X.
    orientation : (K, 3, 3) array, optional
        Of the sensors after the turn, by right angles; by default the nearest.

    Returns
    -------
    SensorErrors, (12 K, 12 K + 3) array
        Errors, and their derivative by those given and by δ, radians.
    """
    count = errors.sensor_count
    after = SensorErrors.from_matrix(errors.matrix @ rotation, errors.bias_T, orientation)
    rows = np.zeros((count, 3, 4, 12 * count + 3))
    for sensor, own in enumerate(errors.jacobian()):
        columns = slice(12 * sensor, 12 * sensor + 12)
        rows[sensor, :, :3, columns] = np.einsum("ijp,jk->ikp", own[:, :3], rotation)
        rows[sensor, :, 3, columns] = own[:, 3]
    rows[:, :, :3, -3:] = np.einsum("kij,djl,lm->kimd", errors.matrix, _CROSS, rotation)
    back = inv(after.jacobian().reshape(count, 12, 12))
    return after, (back @ rows.reshape(count, 12, -1)).reshape(12 * count, -1)


def in_first_frame(errors: SensorErrors) -> tuple[SensorErrors, FloatArray]:
    """Return errors turned into the frame of sensor 1, and the (12 K, 12 K) derivative by the errors given."""
    first = errors.rotation[0]
    after, derivative = turned(errors, first.T, errors.orientation @ errors.orientation[0].T)
    after.misalignment[0] = 0
    # The frame turns with sensor 1: [δ]× is the change of its transposed rotation times that rotation.
    change = np.einsum("ij,jkp->ikp", inv(errors.measurement[0]), errors.jacobian()[0, :, :3, 9:12])
    skew = np.einsum("ijp,ik->jkp", change, first)
    derivative[:, 9:12] += derivative[:, -3:] @ skew[[2, 0, 1], [1, 2, 0]]
    derivative[9:12] = 0
    return after, derivative[:, :-3]
