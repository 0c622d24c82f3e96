"""The integrated calibration of Chi 2017: sensor errors, misalignment, and the hard and soft iron of the vehicle.

With soft iron a sensor reads C b + o with any matrix C (eq. 5). Its ellipsoid is fitted by least squares under a
constraint that admits ellipsoids only, split by Cholesky factorisation, and the sensors are aligned by Procrustes.
"""

import numpy as np
from numpy.linalg import LinAlgError, inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid, recorded_attitude
from tam_calibration.fit.moments import Moments, field_products, finish, gather, procrustes
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray

FRAME_STATEMENT = (
    "The array frame is the frame in which the matrix of sensor 1 is upper triangular. With soft iron that is not the "
    "frame of its axes, and it may be turned against the array by tens of degrees. A uniform field then looks perfect, "
    "but the components of the field and of a source's gradient are turned with it. Record the attitude, "
    "and the frame is taken from it."
)

_RATIOS = (100.0, 4.0)
"""Bounds on I²/J of the ellipsoid, I the trace of A and J the sum of its principal minors (Li and Griffiths 2004).

It is 3 for a sphere. The first bound admits axes of 14 to 1; what is fitted under the second is always an ellipsoid.
"""


def integrated(recording: SampleSource, array: Array) -> Calibration:
    """Fit the matrices and biases of sensors near iron by Chi 2017.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field of an intensity that is taken as constant, the mean square of the scalar readings;
        the iron is fixed to the array.
    array : Array
        Geometry and noise.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples. Scale factors and angles are those of D Λ = C, the
        soft iron in them: in the frame whose attitude was recorded, or without attitude as ``FRAME_STATEMENT`` says.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    recording = recording.whole()
    moments = gather(recording, "integrated")
    shape, center = constrained_ellipsoid(moments.quartic, moments.mean_square)
    unmix = ellipsoid.square_root(shape)
    products = field_products(moments.joint, unmix, center)
    matrix = inv(unmix) @ procrustes(products[:, :, 0])
    if recording.attitude is None:
        return finish("integrated", recording, array, moments.data, matrix, center, FRAME_STATEMENT)
    matrix = matrix @ np.swapaxes(_turns(moments, matrix, center), 1, 2)[:, None]
    return finish("integrated", recording, array, moments.data, matrix, center, recorded_attitude.FRAME_STATEMENT)


def _turns(moments: Moments, matrix: FloatArray, center: FloatArray) -> FloatArray:
    """Return the rotations (S, 3, 3) from the frame of sensor 1 to the one whose attitude was recorded."""
    from scipy.spatial.transform import Rotation

    known = moments.known()
    assert known.attitude is not None
    has_attitude = np.isfinite(known.attitude).all(axis=1)
    to_world = Rotation.from_quat(known.attitude[has_attitude]).as_matrix()
    points = (known.readings_T[has_attitude, 0] - moments.data.origin_T[0]) / moments.data.radius_T
    chosen = np.ones((len(matrix), known.sample_count), dtype=bool)
    for index, left_out in enumerate(moments.left_out()):
        chosen[index + 1, left_out] = False
    chosen, turns = chosen[:, has_attitude], []
    for unmix, bias, samples in zip(inv(matrix[:, 0]), center[:, 0], chosen, strict=True):
        field = (points[samples] - bias) @ unmix.T
        turns.append(recorded_attitude.find_turn(field, to_world[samples]))
    return np.array(turns)


def constrained_ellipsoid(moments: FloatArray, mean_square: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the shapes and centres of the ellipsoids nearest to points in algebraic distance: Chi 2017 eqs. 9 to 14.

    Parameters
    ----------
    moments : (..., 11, 11) array
        Of ``ellipsoid.monomials``, points scaled to order one.
    mean_square : (...) array
        Square of the intensity.

    Returns
    -------
    (..., 3, 3) array, (..., 3) array
        A and o of (p - o)ᵀ A (p - o) = mean_square.

    Raises
    ------
    InputError
        When the points determine no ellipsoid.
    """
    for ratio in _RATIOS:
        try:
            shape, linear, constant = _nearest(moments, ratio)
            center = -np.linalg.solve(shape, linear[..., None])[..., 0] / 2
        except LinAlgError:
            raise InputError(ellipsoid.NO_ELLIPSOID) from None
        if (np.linalg.eigvalsh(shape)[..., 0] > 0).all():
            break
    size = np.einsum("...i,...ij,...j->...", center, shape, center) - constant
    return shape * (mean_square / size)[..., None, None], center


def _nearest(moments: FloatArray, ratio: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return A, the linear and the constant coefficients that minimise the algebraic distance with ratio J - I² = 1."""
    square, mixed, rest = moments[..., :6, :6], moments[..., :6, 6:10], moments[..., 6:10, 6:10]
    eliminate = np.linalg.solve(rest, np.swapaxes(mixed, -1, -2))
    constraint = np.diag([-1.0] * 3 + [-ratio] * 3)
    constraint[:3, :3] += (ratio / 2 - 1) * (1 - np.eye(3))
    values, vectors = np.linalg.eig(inv(constraint) @ (square - mixed @ eliminate))
    # One value is positive, or zero without noise; the others are negative.
    chosen = np.argmax(values.real, axis=-1)[..., None, None]
    quadratic = np.take_along_axis(vectors.real, chosen, axis=-1)[..., 0]
    quadratic = quadratic * np.sign(quadratic[..., :3].sum(axis=-1, keepdims=True))
    linear = -(eliminate @ quadratic[..., None])[..., 0]
    return ellipsoid.symmetric(quadratic), linear[..., :3], linear[..., 3]
