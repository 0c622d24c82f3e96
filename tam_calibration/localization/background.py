"""What the channels of a platform read beside an alternating source: a slow drift, and the field that it turns in."""

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.localization.euler import tensors_of
from tam_calibration.units import FloatArray

_DEGREE = 3
_SMALLEST_SHARE = 1e-9


def background_of(
    time_s: FloatArray, attitude: FloatArray | None = None, *, knot_spacing_s: float = np.inf
) -> FloatArray:
    """Return orthonormal columns (N, Q) that span the background of any channel of a platform.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world. With them the columns hold the nine elements of the
        rotation: a channel that is linear in the field, calibrated or not, then follows any turning in a uniform field.
    knot_spacing_s : float
        Of the cubic splines of time, at least two periods of the source; by default there is one piece, a cubic.

    Returns
    -------
    (N, Q) array
        Orthonormal.

    Raises
    ------
    InputError
        When the spacing is not positive or there are fewer samples than columns.
    """
    from scipy.interpolate import BSpline

    time = np.asarray(time_s, dtype=float)
    if not knot_spacing_s > 0:
        raise InputError(f"the spacing of knots must be a positive number of seconds, not {knot_spacing_s}")
    pieces = max(1, int(np.ceil(np.ptp(time) / knot_spacing_s)))
    inner = np.linspace(time[0], time[-1], pieces + 1)
    knots = np.concatenate([np.full(_DEGREE, time[0]), inner, np.full(_DEGREE, time[-1])])
    columns = BSpline.design_matrix(time, knots, _DEGREE).toarray()
    if attitude is not None:
        columns = np.concatenate([columns, _rotations(attitude).reshape(len(time), 9)], axis=1)
    if columns.shape[1] >= len(time):
        raise InputError(f"{len(time)} samples are too few for a background of {columns.shape[1]} columns")
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    spanning: FloatArray = left[:, size > _SMALLEST_SHARE * size[0]]
    return spanning


def without(background: FloatArray, channels: FloatArray) -> FloatArray:
    """Return channels (N, D) less what orthonormal columns (N, Q) make of them."""
    rest: FloatArray = channels - background @ (background.T @ channels)
    return rest


def turning_of(attitude: FloatArray, channel_count: int) -> FloatArray:
    """Return the (N, D, D) matrices from amplitudes that rest in the world to those in the array frame.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    channel_count : int
        D: 3 for a field, 8 for field and gradient in the order of ``array.OUTPUT_NAMES`` without gzz.

    Raises
    ------
    InputError
        When there is another number of channels.
    """
    if channel_count not in (3, 8):
        raise InputError(f"a platform turns a field of 3 channels, or field and gradient of 8, not {channel_count}")
    matrix = _rotations(attitude)
    turning = np.zeros((len(matrix), channel_count, channel_count))
    turning[:, :3, :3] = np.swapaxes(matrix, 1, 2)
    if channel_count > 3:
        components = tensors_of(np.eye(8)[3:])
        turned = np.swapaxes(matrix, 1, 2)[:, None] @ components @ matrix[:, None]
        rows = [turned[..., 0, 0], turned[..., 0, 1], turned[..., 0, 2], turned[..., 1, 1], turned[..., 1, 2]]
        turning[:, 3:, 3:] = np.stack(rows, axis=1)
    return turning


def _rotations(attitude: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    matrix: FloatArray = Rotation.from_quat(attitude).as_matrix()
    return matrix
