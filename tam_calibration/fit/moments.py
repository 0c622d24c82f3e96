"""The moments of a recording, of all its samples and with each group of samples left out, and the way back from them.

A method that needs no more than these is worked out for all sets at once, and its covariance is a jackknife.
"""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.normal_equations import gram
from tam_calibration.correction.calibration import FRAME_STATEMENT, Calibration
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.estimate import Estimate, make_calibration
from tam_calibration.fit.scale import Normalized, free_scale, normalize
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import BLOCK, Recording, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray

_JACKKNIFE_GROUPS = 64
_FEWEST_SAMPLES = 10
"""An ellipsoid has nine parameters; one sample more lets the jackknife leave one out."""


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

    def left_out(self) -> list[IntArray]:
        """Return which of these samples each set but the first leaves out."""
        groups = len(self.joint) - 1
        counts = [int(np.isfinite(intensity).sum()) for _, intensity in self.data.blocks()]
        number = np.concatenate([np.arange(count) // _length_of_run(count, groups) for count in counts])
        return [np.flatnonzero(number == group) for group in range(groups)]

    @property
    def mean_square(self) -> FloatArray:
        """(S, 1) mean square of the intensity, in units of the radius."""
        mean: FloatArray = self.quartic[:, :1, 9, 10] / self.quartic[:, :1, 9, 9]
        return mean

    def with_constant_intensity(self) -> "Moments":
        """Return the moments that the readings would have beside a constant intensity of the same mean square."""
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
    if known < _FEWEST_SAMPLES:
        raise InputError(f"{known} samples are too few for the {method} calibration: it needs {_FEWEST_SAMPLES}")
    if source.sample_count <= BLOCK:
        groups = -(-known // _length_of_run(known, min(groups, known)))
    data = normalize(source)
    sensors = source.sensor_count + with_platform
    quartic, joint = np.zeros((groups, sensors, 11, 11)), np.zeros((groups, 3 * sensors + 1, 3 * sensors + 1))
    for points, intensity in data.blocks():
        _add_block(quartic, joint, points, intensity)
    return Moments(_with_each_left_out(quartic), _with_each_left_out(joint), data)


def _add_block(quartic: FloatArray, joint: FloatArray, points: FloatArray, intensity: FloatArray) -> None:
    """Add to the moments (G, K, 11, 11) and (G, 3K+1, 3K+1) of groups of samples, dealt in short runs in turn."""
    groups, sensors = quartic.shape[:2]
    finite = np.isfinite(intensity)
    if not finite.all():
        points, intensity = points[:, finite], intensity[finite]
    if len(points) < 3 * sensors:
        mean = points[:-1].reshape(sensors - 1, 3, -1).mean(axis=0)
        points = np.concatenate([points[:-1], mean, points[-1:]])
    monomials = np.empty((11, points.shape[1]))
    for sensor in range(sensors):
        ellipsoid.monomial_columns(points[3 * sensor : 3 * sensor + 3], intensity, monomials)
        quartic[:, sensor] += _products_of_runs(monomials, groups)
    joint += _products_of_runs(points, groups)


def _products_of_runs(columns: FloatArray, groups: int) -> FloatArray:
    """Return the (G, M, M) sums of the outer products of columns (M, N), of G runs of equal length."""
    width, count = columns.shape
    if groups == 1:
        return gram(columns)[None]
    run = _length_of_run(count, groups)
    if run * groups != count:
        columns = np.pad(columns, ((0, 0), (0, run * groups - count)))
    dealt = np.swapaxes(columns.reshape(width, groups, run), 0, 1)
    products: FloatArray = dealt @ np.swapaxes(dealt, 1, 2)
    return products


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
    estimate = Estimate(
        SensorErrors.from_vector(vectors[0], orientation),
        jackknife(vectors[1:]),
        covariance_from_noise=False,
        intensity_T=float(data.radius_T / factor[0]),
        frame=frame,
    )
    return make_calibration(method, source, array, estimate)


def jackknife(replicates: FloatArray) -> FloatArray:
    """Return the covariance of the flattened estimates (G, ...) that leave one group out each."""
    groups = len(replicates)
    deviation = (replicates - replicates.mean(axis=0)).reshape(groups, -1)
    covariance: FloatArray = (groups - 1) / groups * deviation.T @ deviation
    return covariance
