"""Published methods that fit each sensor's ellipsoid and then align the sensors.

The fast rotation calibration of Li 2018b: each sensor's ellipsoid, then the alignment to the mean reading.

The paper calibrates from ten samples of one turn about one axis. Such a turn determines 5 of the 9 parameters of a
sensor and 32 of the 45 of a cross; turns about z and x determine 44, about z, x and y all. What holds of the paper is
the alignment: three samples align sensors that are orthogonal already.

The artificial vector calibration of Li 2018a: the mean reading of the sensors, calibrated, is everyone's reference.

The mean reading B_0 is that of a sensor in the centre with errors of its own (eq. 2). Its ellipsoid against the scalar
reference gives the artificial vector B (eqs. 15 to 21), and twelve parameters of each sensor are fitted to it (eq. 7).
The model T M (B_i - I) with twelve free parameters is any affine map, so that the paper's Levenberg-Marquardt iteration
ends where a linear regression does. Where all sensors have the same noise it reaches the Cramér-Rao bound.

B lies along the orthogonal frame of the mean reading, not along the platform as the paper says: in its own simulation
the two are 1.2, 2.0 and -0.9 degrees apart. Here the result is turned into the frame of sensor 1, as every method's.

The simplified linear calibration of Zhang 2015: the errors to first order, then the alignment.

Li 2018a and Li 2018b compare themselves with it. It leaves what is of second order in the errors, about a thousand
nanotesla for scale factors that are a quarter off: neither noise-free data nor more samples remove that.

The two-step linear calibration of Yin 2014: each sensor's ellipsoid by least squares, then a linear alignment.

Built from what Li 2018a and Wu 2025 say of it: no simplification of the ellipsoid, a constant intensity, and the
misalignment from linear regression, angle by angle. That alignment reaches the Cramér-Rao bound, as Procrustes analysis
does not: it regresses what the errors of the ellipsoids, upper triangular, do not touch.

The lossless scalar calibration of Wu 2025 in three steps, from moments of one pass over the data.

The integrated calibration of Chi 2017: sensor errors, misalignment, and the hard and soft iron of the vehicle.

With soft iron a sensor reads C b + o with any matrix C (eq. 5). Its ellipsoid is fitted by least squares under a
constraint that admits ellipsoids only, split by Cholesky factorisation, and the sensors are aligned by Procrustes.
"""

from dataclasses import replace

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.field_alignment import find_turn
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.moments import (
    Moments,
    field_products,
    finish,
    gather,
    into_frame_of_first,
    procrustes,
    rotation_by_regression,
)
from tam_calibration.fit.recorded_attitude import FRAME_STATEMENT as RECORDED_FRAME
from tam_calibration.model.array import Array
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.units import FloatArray


def _rotation_against_first(moments: Moments, unmix: FloatArray, center: FloatArray) -> FloatArray:
    """Return the rotations Λ (S, K, 3, 3), by regression of sensor 1's field on each sensor's."""
    products = field_products(moments.joint, unmix, center)
    own = np.moveaxis(np.diagonal(products, axis1=1, axis2=2), -1, 1)
    return rotation_by_regression(products[:, 0] @ inv(own))


def two_step_linear(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors by Yin 2014.

    The intensity is taken as constant: the mean square of the scalar readings.

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
        When the readings determine no ellipsoid, or a sensor cannot be aligned.
    """
    moments = gather(recording, "two-step linear").with_constant_intensity()
    center, unmix = ellipsoid.fitted(moments.quartic)
    matrix = inv(unmix) @ _rotation_against_first(moments, unmix, center)
    return finish("two_step_linear", recording, array, moments.data, matrix, center)


FIRST_ORDER = (
    "standard errors hold all that the first order leaves, which is no noise and does not become less with more "
    "samples: 95 % intervals hold in more than 95 % of recordings"
)


def simplified_linear(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors to first order.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one. Without any, the
        intensity is taken from the mean radius of the readings.
    array : Array
        Geometry and noise.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples, and of what the first order leaves: the difference to
        ``two_step_linear``.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or a sensor cannot be aligned.
    """
    moments = gather(recording, "simplified linear")
    # The expansion is about error-free sensors: it needs readings from zero, not from their centre.
    zero = -moments.data.origin_T / moments.data.radius_T
    from_zero = ellipsoid.move_origin(moments.quartic, np.broadcast_to(zero, (len(moments.quartic), *zero.shape)))
    unmix, bias = first_order(from_zero)
    center = bias + zero
    matrix = inv(unmix) @ _rotation_against_first(moments, unmix, center)
    calibration = finish("simplified_linear", recording, array, moments.data, matrix, center)
    # What the first order leaves is no noise, and is the same for any number of samples.
    left = calibration.errors.to_vector() - two_step_linear(recording, array).errors.to_vector()
    covariance = calibration.covariance + np.outer(left, left)
    return replace(calibration, covariance=covariance, notes=(*calibration.notes, FIRST_ORDER))


@ellipsoid.determined()
def first_order(moments: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return M and i of the field M (z - i) that meets s² - |z|² = 2 Σ δ z² + 2 (m xy + g xz + n yz) - 2 zᵀi.

    Parameters
    ----------
    moments : (..., 11, 11) array
        Of ``ellipsoid.monomials`` of readings z from zero and intensities s, in one unit.

    Returns
    -------
    (..., 3, 3) array, (..., 3) array
        M = [[1 + δx, m, g], [0, 1 + δy, n], [0, 0, 1 + δz]] and i.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid.
    """
    right = moments[..., :9, 10] - moments[..., :9, :3].sum(axis=-1)
    unknowns = np.linalg.solve(moments[..., :9, :9], right[..., None])[..., 0]
    unmix = np.zeros((*unknowns.shape[:-1], 3, 3))
    unmix[..., ellipsoid.ROWS, ellipsoid.COLUMNS] = unknowns[..., :6] / [2, 2, 2, 1, 1, 1]
    return unmix + np.eye(3), -unknowns[..., 6:] / 2


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
    center, shape = ellipsoid.fitted(moments.quartic[:, -1])
    # The moments of each sensor's reading and 1, and of these by the platform's reading, which comes last.
    one = 3 * sensors + 3
    columns = [[3 * sensor, 3 * sensor + 1, 3 * sensor + 2, one] for sensor in range(sensors)]
    square = np.stack([moments.joint[:, rows][:, :, rows] for rows in columns], axis=1)
    cross = np.stack([moments.joint[:, rows, one - 3 : one] for rows in columns], axis=1)
    # The mean reading less its bias, then the field, as an affine map of each sensor's reading.
    cross = cross - square[..., 3, None] * center[:, None, None, :]
    unmix, bias = regress(square, cross @ np.swapaxes(shape, 1, 2)[:, None])
    matrix = into_frame_of_first(inv(unmix)).reshape(sets, sensors, 3, 3)
    return finish("artificial_vector", recording, array, moments.data, matrix, bias)


@ellipsoid.determined()
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
    affine = np.linalg.solve(square, cross)
    unmix = np.swapaxes(affine[..., :3, :], -1, -2)
    return unmix, -np.linalg.solve(unmix, affine[..., 3, :, None])[..., 0]


def fast_rotation(recording: SampleSource, array: Array) -> Calibration:
    """Fit the errors of the sensors by Li 2018b, where the turns determine them.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field, the array turned about three axes; those without a scalar reading are left out where
        others have one.
    array : Array
        Geometry and noise of the K sensors.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the turns leave parameters open, as one turn about one axis does; it names them. When sensors
        are mirror images of others.
    """
    require_determined(recording.thinned(SKETCH), array)
    moments = gather(recording, "fast rotation", with_platform=True)
    center, unmix = ellipsoid.fitted(moments.quartic)
    sensors = recording.sensor_count
    to_platform = field_products(moments.joint, unmix, center)[:, :sensors, sensors]
    matrix = into_frame_of_first(inv(unmix[:, :sensors]) @ procrustes(to_platform))
    return finish("fast_rotation", recording, array, moments.data, matrix, center[:, :sensors])


def lossless(recording: SampleSource, array: Array, *, as_published: bool = False) -> Calibration:
    """Fit the errors of the sensors by Wu 2025.

    Parameters
    ----------
    recording : SampleSource
        Samples in a uniform field; those without a scalar reading are left out where others have one.
    array : Array
        Geometry and noise.
    as_published : bool
        Step 1 as printed: a constant intensity. Otherwise its right-hand side follows the scalar reading. Either way
        the linear solution is kept, at which the sequential quadratic programming on eq. 12 ends too.

    Returns
    -------
    Calibration
        With the covariance of a jackknife over groups of samples.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid, or sensors are mirror images of others.
    """
    moments = gather(recording, "lossless")
    center = ellipsoid.center_of((moments.with_constant_intensity() if as_published else moments).quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    matrix = inv(unmix) @ procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    name = "lossless (as published)" if as_published else "lossless"
    return finish(name, recording, array, moments.data, matrix, center)


FRAME_WITH_SOFT_IRON = (
    "The array frame is the frame in which the matrix of sensor 1 is upper triangular. With soft iron that is not the "
    "frame of its axes, and it may be turned against the array by tens of degrees. A uniform field then looks perfect, "
    "but the components of the field and of a source's gradient are turned with it. Record the attitude, "
    "and the frame is taken from it."
)


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
        soft iron in them: in the frame whose attitude was recorded, or else as ``FRAME_WITH_SOFT_IRON`` says.

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
        return finish("integrated", recording, array, moments.data, matrix, center, FRAME_WITH_SOFT_IRON)
    matrix = matrix @ np.swapaxes(_turns(moments, matrix, center), 1, 2)[:, None]
    return finish("integrated", recording, array, moments.data, matrix, center, RECORDED_FRAME)


def _turns(moments: Moments, matrix: FloatArray, center: FloatArray) -> FloatArray:
    """Return the rotations (S, 3, 3) from the frame of sensor 1 to the one whose attitude was recorded."""
    known = moments.known()
    assert known.attitude is not None
    has_attitude = np.isfinite(known.attitude).all(axis=1)
    to_world = matrices_of(known.attitude[has_attitude])
    points = (known.readings_T[has_attitude, 0] - moments.data.origin_T[0]) / moments.data.radius_T
    set_without, turns = moments.set_without()[has_attitude], []
    for number, (unmix, bias) in enumerate(zip(inv(matrix[:, 0]), center[:, 0], strict=True)):
        samples = set_without != number
        field = (points[samples] - bias) @ unmix.T
        turns.append(find_turn(field, to_world[samples]))
    return np.array(turns)


@ellipsoid.determined()
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
    # Bounds on I²/J of the ellipsoid, I the trace of A and J the sum of its principal minors (Li and
    # Griffiths 2004). It is 3 for a sphere. The first bound admits axes of 14 to 1; what is fitted under the second is
    # always an ellipsoid.
    for ratio in (100.0, 4.0):
        shape, linear, constant = _nearest(moments, ratio)
        center = -np.linalg.solve(shape, linear[..., None])[..., 0] / 2
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
