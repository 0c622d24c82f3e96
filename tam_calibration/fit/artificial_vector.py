"""The artificial vector calibration of Li 2018a: the mean reading of the sensors, calibrated, is everyone's reference.

The mean reading B_0 is that of a sensor in the centre with errors of its own (eq. 2). Its ellipsoid against the scalar
reference gives the artificial vector B (eqs. 15 to 21), and twelve parameters of each sensor are fitted to it (eq. 7).
The model T M (B_i - I) with twelve free parameters is any affine map, so that the paper's Levenberg-Marquardt iteration
ends where a linear regression does. Where all sensors have the same noise it reaches the Cramér-Rao bound.

B lies along the orthogonal frame of the mean reading, not along the platform as the paper says: in its own simulation
the two are 1.2, 2.0 and -0.9 degrees apart. Here the result is turned into the frame of sensor 1, as every method's.
"""

import numpy as np
from numpy.linalg import LinAlgError, inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import into_frame_of_first
from tam_calibration.fit.moments import finish, gather
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray


def artificial_vector(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors by Li 2018a.

    The ellipsoid has nine unknowns about its centre, and its intensity may vary: the ten unknowns of eqs. 18 and 19
    have with a constant one the trivial solution V = (0, …, 0, H).

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise of the K sensors.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    moments = gather(recording, "artificial vector", with_platform=True)
    sets, sensors = len(moments.joint), recording.sensor_count
    platform = moments.quartic[:, -1]
    center = ellipsoid.center_of(platform)
    shape = ellipsoid.square_root(ellipsoid.shape_about(platform, center))
    square, cross = _normal_equations(moments.joint, sensors)
    # The mean reading less its bias, then the field, as an affine map of each sensor's reading.
    cross = cross - square[..., 3, None] * center[:, None, None, :]
    unmix, bias = regress(square, cross @ np.swapaxes(shape, 1, 2)[:, None])
    matrix = into_frame_of_first(inv(unmix)).reshape(sets, sensors, 3, 3)
    return finish("artificial_vector", recording, array, moments.data, matrix, bias)


def _normal_equations(joint: FloatArray, sensors: int) -> tuple[FloatArray, FloatArray]:
    """Return the moments (S, K, 4, 4) of each sensor's reading and 1, and (S, K, 4, 3) of these by the platform's."""
    one = joint.shape[1] - 1
    columns = [[3 * sensor, 3 * sensor + 1, 3 * sensor + 2, one] for sensor in range(sensors)]
    square = np.stack([joint[:, rows][:, :, rows] for rows in columns], axis=1)
    cross = np.stack([joint[:, rows, one - 3 : one] for rows in columns], axis=1)
    return square, cross


def regress(square: FloatArray, cross: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return T M and I of the fields T M (B_i - I) nearest to a reference: Li 2018a eqs. 7 to 14.

    Parameters
    ----------
    square : (..., 4, 4) array
        Sums of the outer products of (B_i, 1).
    cross : (..., 4, 3) array
        Sums of (B_i, 1) by the reference.

    Returns
    -------
    (..., 3, 3) array, (..., 3) array
        The matrix and the bias.

    Raises
    ------
    InputError
        When the readings lie in a plane.
    """
    try:
        affine = np.linalg.solve(square, cross)
        unmix = np.swapaxes(affine[..., :3, :], -1, -2)
        bias = -np.linalg.solve(unmix, affine[..., 3, :, None])[..., 0]
    except LinAlgError:
        raise InputError(ellipsoid.NO_ELLIPSOID) from None
    return unmix, bias
