"""The moments of a recording, of all its samples and with each group of samples left out, and the way back from them.

A method that needs no more than these is worked out for all sets at once, and its covariance is a jackknife.

Sensors that are orthogonal already are aligned by Procrustes analysis, or by linear regression. Every function takes
any number of leading axes and treats each of them apart.

A fit sees the handedness of sensors only against each other or against a reference that is made of them: that sensor 2
is a mirror image of sensor 1 is the same finding as that sensor 1 is one of sensor 2. The fewer are named first.
"""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.least_squares import gram
from tam_calibration.correction.calibration import FRAME_STATEMENT, Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.ellipsoid import Normalized, free_scale, normalize
from tam_calibration.fit.estimate import make_calibration
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, numbered
from tam_calibration.model.recording import BLOCK, Recording, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray, from_degrees

_JACKKNIFE_GROUPS = 64


@dataclass(frozen=True, eq=False)
class Moments:
    """Moments of S sets of samples: the first is of all samples, each other leaves a group out.

    Parameters
    ----------
    quartic : (S, K, 11, 11) array
        Of the monomials of ``ellipsoid.monomials`` of each sensor.
    joint : (S, 3K+1, 3K+1) array
        Of the readings of all sensors, and 1.
    data : Normalized
        The samples, about the origins and in the unit of the moments.
    """

    quartic: FloatArray
    joint: FloatArray
    data: Normalized

    def known(self) -> Recording:
        """Return the samples that count, in memory."""
        recording = self.data.source.whole()
        return recording if recording.scalar_T is None else recording.take(np.isfinite(recording.scalar_T))

    def set_without(self) -> IntArray:
        """Return the number of the set that leaves each of these samples out."""
        groups = len(self.joint) - 1
        counts = [int(np.isfinite(intensity).sum()) for _, intensity in self.data.blocks()]
        return 1 + np.concatenate([np.arange(count) // _length_of_run(count, groups) for count in counts])

    @property
    def mean_square(self) -> FloatArray:
        """(S, 1) mean square of the intensity, in units of the radius."""
        return self.quartic[:, :1, 9, 10] / self.quartic[:, :1, 9, 9]

    def with_constant_intensity(self) -> "Moments":
        """Return the moments that the readings would have with a constant intensity of the same mean square."""
        quartic = self.quartic.copy()
        quartic[..., :, 10] = self.mean_square[..., None] * quartic[..., :, 9]
        quartic[..., 10, :] = self.mean_square[..., None] * quartic[..., 9, :]
        return replace(self, quartic=quartic)


def gather(
    source: SampleSource, method: str, *, with_platform: bool = False, groups: int = _JACKKNIFE_GROUPS
) -> Moments:
    """Return the moments of the samples that have a scalar reading, or of all where none has, in one pass.

    Parameters
    ----------
    source : SampleSource
        Samples in a uniform field.
    method : str
        What needs them, for people.
    with_platform : bool
        Whether the mean reading of the sensors follows them as one sensor more (Li 2018a eq. 2).
    groups : int
        Number of groups to leave out in turn; 1 for none.

    Raises
    ------
    InputError
        When there are too few samples.
    """
    known = source.sample_count if source.scalar_count is None else source.scalar_count
    # An ellipsoid has nine parameters; one sample more lets the jackknife leave one out.
    fewest_samples = 10
    if known < fewest_samples:
        raise InputError(f"{known} samples are too few for the {method} calibration: it needs {fewest_samples}")
    if source.sample_count <= BLOCK:
        groups = -(-known // _length_of_run(known, min(groups, known)))
    data = normalize(source)
    sensors = source.sensor_count + with_platform
    quartic, joint = np.zeros((groups, sensors, 11, 11)), np.zeros((groups, 3 * sensors + 1, 3 * sensors + 1))
    for points, intensity in data.blocks():
        finite = np.isfinite(intensity)
        if not finite.all():
            points, intensity = points[:, finite], intensity[finite]
        if with_platform:
            mean = points[:-1].reshape(sensors - 1, 3, -1).mean(axis=0)
            points = np.concatenate([points[:-1], mean, points[-1:]])
        for sensor in range(sensors):
            monomials = ellipsoid.monomial_columns(points[3 * sensor : 3 * sensor + 3], intensity)
            quartic[:, sensor] += _products_of_runs(monomials, groups)
        joint += _products_of_runs(points, groups)
    return Moments(_with_each_left_out(quartic), _with_each_left_out(joint), data)


def _products_of_runs(columns: FloatArray, groups: int) -> FloatArray:
    """Return the (G, M, M) sums of the outer products of columns (M, N), dealt in G runs of equal length."""
    width, count = columns.shape
    if groups == 1:
        return gram(columns)[None]
    run = _length_of_run(count, groups)
    if run * groups != count:
        columns = np.pad(columns, ((0, 0), (0, run * groups - count)))
    dealt = np.swapaxes(columns.reshape(width, groups, run), 0, 1)
    return dealt @ np.swapaxes(dealt, 1, 2)


def _length_of_run(count: int, groups: int) -> int:
    return -(-count // groups)


def _with_each_left_out(groups: FloatArray) -> FloatArray:
    total = groups.sum(axis=0)
    return total[None] if len(groups) == 1 else np.concatenate([total[None], total - groups])


def finish(
    method: str,
    source: SampleSource,
    array: Array,
    data: Normalized,
    matrix: FloatArray,
    center: FloatArray,
    frame: str = FRAME_STATEMENT,
) -> Calibration:
    """Return the calibration of what a method found for each set.

    Parameters
    ----------
    method : str
        Its name.
    source, array : SampleSource, Array
        What it was given.
    data : Normalized
        Of the moments.
    matrix : (S, K, 3, 3) array
        D Λ of each sensor in the common frame.
    center : (S, K, 3) array
        Bias of each sensor about its origin, in units of the radius.
    frame : str
        What the common frame is; by default the orthogonal frame of sensor 1.
    """
    factor = np.ones(len(matrix)) if data.has_scalar else free_scale(matrix)
    bias = data.origin_T + data.radius_T * center
    matrix = matrix * factor[:, None, None, None]
    orientation = SensorErrors.from_matrix(matrix[0], bias[0]).orientation
    orientations = np.tile(orientation, (len(matrix), 1, 1))
    every = SensorErrors.from_matrix(matrix.reshape(-1, 3, 3), bias.reshape(-1, 3), orientations)
    vectors = every.to_vector().reshape(*bias.shape[:2], 12)
    if frame == FRAME_STATEMENT:
        vectors[:, 0, 9:] = 0
    errors = SensorErrors.from_vector(vectors[0], orientation)
    covariance = lasting_factor(vectors[1:]) * jackknife(vectors[1:])
    return make_calibration(method, source, array, errors, covariance, float(data.radius_T / factor[0]), frame=frame)


def jackknife(replicates: FloatArray) -> FloatArray:
    """Return the covariance of the flattened estimates (G, ...) that leave one group out each.

    So few groups tell the standard errors to a tenth only: these are widened so that 1.96 of them cover 95 %, by
    Student's t with G - 1 degrees of freedom.
    """
    from scipy.special import ndtri, stdtrit

    groups = len(replicates)
    deviation = (replicates - replicates.mean(axis=0)).reshape(groups, -1)
    wider = (stdtrit(groups - 1, 0.975) / ndtri(0.975)) ** 2
    return np.asarray(wider * (groups - 1) / groups * deviation.T @ deviation)


def lasting_factor(replicates: FloatArray) -> float:
    """Return by how much the variance of an estimate exceeds that of groups (G, ...) that were independent.

    Noise that lasts longer than a group is correlated between neighbours. The factor is 1 + 2 Σ r_k, with r_k the
    autocorrelation of what the groups add to the estimate, k groups apart, of all parameters together, up to the first
    that is not positive (Geyer 1992). That of independent groups is -1/G in the mean.
    """
    groups = len(replicates)
    deviation = (replicates - replicates.mean(axis=0)).reshape(groups, -1)
    size = deviation.std(axis=0)
    white = deviation[:, size > 0] / size[size > 0]
    factor = 1.0
    for lag in range(1, groups):
        correlation = float(np.sum(white[lag:] * white[:-lag])) / white.size + 1 / groups
        if correlation <= 0:
            break
        factor += 2 * correlation
    return factor


def field_products(joint: FloatArray, unmix: FloatArray, center: FloatArray) -> FloatArray:
    """Return the sums of the outer products of the restored fields.

    Parameters
    ----------
    joint : (S, 3K+1, 3K+1) array
        Moments of all readings, and 1.
    unmix : (S, K, 3, 3) array
        From unbiased readings to the field in each sensor's own frame.
    center : (S, K, 3) array
        Biases.

    Returns
    -------
    (S, K, K, 3, 3) array
        At k, l the sum of b_k b_lᵀ.
    """
    sets, sensors = center.shape[:2]
    each = np.einsum("kl,skij->skilj", np.eye(sensors), unmix).reshape(sets, 3 * sensors, -1)
    restore = np.concatenate([each, (-unmix @ center[..., None]).reshape(sets, -1, 1)], axis=2)
    products: FloatArray = restore @ joint @ np.swapaxes(restore, 1, 2)
    return np.swapaxes(products.reshape(sets, sensors, 3, sensors, 3), 2, 3)


def procrustes(cross: FloatArray) -> FloatArray:
    """Return the rotations Λ that turn a reference into each sensor's field.

    Parameters
    ----------
    cross : (..., K, 3, 3) array
        Sums of b_k bᵀ, b the reference.

    Returns
    -------
    (..., K, 3, 3) array
        Minimising the sum of |b_k - Λ_k b|² over rotations (Chi 2017 eq. 16, the other way round).

    Raises
    ------
    InputError
        When sensors are mirror images of others; it has their numbers.
    """
    left, _, right = np.linalg.svd(cross)
    rotation: FloatArray = left @ right
    require_one_hand(rotation)
    return rotation


def rotation_by_regression(regression: FloatArray) -> FloatArray:
    """Return the rotations Λ of the sensors from the regression of a reference on their fields, angle by angle.

    The z row of b = V b_k gives two angles, the y row the third: the rest of V is not used. Li 2018a compares
    itself with this alignment of Yin 2014, and its Table 2 is met by it.

    Parameters
    ----------
    regression : (..., K, 3, 3) array
        V of each sensor.

    Raises
    ------
    InputError
        When a sensor is turned by more than 80° about y or z: from 90° on the arc sine is wrong, and near it noise is.
        When sensors are mirror images of others.
    """
    require_one_hand(regression)
    # from_degrees(80.0): of a sensor whose angle is found by its sine, radians: noise counts six times there, and
    # without bound at 90°.
    beyond = (regression[..., 0, 0] < np.cos(from_degrees(80.0))).reshape(-1, regression.shape[-3]).any(axis=0)
    if beyond.any():
        raise InputError(
            f"sensor {np.argmax(beyond) + 1} is turned by more than 80° against the reference, "
            "beyond what a linear alignment finds: use the method maximum_likelihood"
        )
    beta = -np.arcsin(np.clip(regression[..., 2, 0], -1, 1))
    alpha = np.arctan2(regression[..., 2, 1], regression[..., 2, 2])
    gamma = np.arcsin(np.clip(regression[..., 1, 0] / np.cos(beta), -1, 1))
    angles = np.stack([alpha, beta, gamma], axis=-1).reshape(-1, 3)
    zero = np.zeros_like(angles)
    rotation: FloatArray = SensorErrors(zero + 1, zero, zero, angles).rotation
    return rotation.reshape(regression.shape)


def into_frame_of_first(matrix: FloatArray) -> FloatArray:
    """Turn the common frame of matrices D Λ (S, K, 3, 3), all of one hand, into the orthogonal frame of sensor 1."""
    require_one_hand(matrix)
    first = SensorErrors.from_matrix(matrix[:, 0], np.zeros((len(matrix), 3))).rotation
    return matrix @ np.swapaxes(first, 1, 2)[:, None]


def require_one_hand(matrix: FloatArray) -> None:
    """Check that all sensors have the same handedness.

    Parameters
    ----------
    matrix : (..., K, 3, 3) array
        Of each sensor, from one common frame to its axes; any of the leading axes may show the mirror image.

    Raises
    ------
    InputError
        When sensors are mirror images of others, or all of the reference; it has their numbers.
    """
    is_mirrored = (np.linalg.det(matrix) < 0).reshape(-1, matrix.shape[-3]).any(axis=0)
    if is_mirrored.any():
        raise InputError(f"{mirror_images(np.where(is_mirrored, -1, 1))}: check the order and signs of the axes")


def mirror_images(hands: IntArray) -> str:
    """Return in words which sensors are mirror images of which, the fewer of them first.

    Parameters
    ----------
    hands : (K,) array
        1 or -1 for the two kinds, at least one of them -1; 0 where it is unknown.
    """
    mirrored, others = (np.flatnonzero(hands == hand) for hand in (-1, 1))
    if not len(others):
        return f"{numbered(mirrored + 1)} {_are_mirror_images(mirrored)} of the reference"
    few, many = sorted((mirrored, others), key=len)
    return f"{numbered(few + 1)} {_are_mirror_images(few)} of {numbered(many + 1)}"


def _are_mirror_images(sensors: IntArray) -> str:
    return "is a mirror image" if len(sensors) == 1 else "are mirror images"
