"""The errors of K tri-axial sensors, forward and inverse, and the residuals that corrected readings leave.

Wu 2025 eqs. 1 to 5: a field b in the array frame makes sensor i read ``D_i Λ_i b + o_i``, with D_i upper
triangular (scale factors, non-orthogonality) and Λ_i the passive rotation Rx(α) Ry(β) Rz(γ) from the array
frame to the sensor's own orthogonal frame. At β = ±90° the angles α and γ turn about one axis and neither is
determined; Λ_i is therefore Rx(α) Ry(β) Rz(γ) Q_i with an orientation Q_i, of which a sensor that is mounted as the
array has none: a rotation that exchanges and reverses axes.

Residuals are those in a uniform field of known intensity, and those of noise alone.
"""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import permutations, product

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.model.array import TENSOR_OUTPUTS, Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Block, Recording, SampleSource
from tam_calibration.model.units import ERROR_KINDS, FloatArray

PARAMETER_NAMES = tuple(f"{kind.name} {axis}" for kind in ERROR_KINDS for axis in kind.axes)
"""Names of the twelve parameters of one sensor, in the order of ``SensorErrors.to_vector``."""

ORIENTATIONS = np.array(
    [
        np.diag(signs)[:, list(axes)]
        for axes in permutations(range(3))
        for signs in product((1.0, -1.0), repeat=3)
        if np.linalg.det(np.diag(signs)[:, list(axes)]) > 0
    ]
)
"""(24, 3, 3) the rotations that exchange and reverse axes, that without effect first."""


@dataclass(frozen=True, eq=False)
class SensorErrors:
    """Scale factor, non-orthogonality, bias and misalignment of K sensors; SI, angles in radians.

    Parameters
    ----------
    scale_factor : (K, 3) array
        Sx, Sy, Sz; 1 is without error.
    non_orthogonality : (K, 3) array
        θ, φ, ψ of Wu 2025 eq. 3.
    bias_T : (K, 3) array
        Reading in zero field.
    misalignment : (K, 3) array
        α, β, γ; zero for sensor 1 where its own frame serves as the array frame, which is all that a
        uniform field can determine.
    orientation : (K, 3, 3) array, optional
        One of the 24 rotations that exchange and reverse axes, from the array frame, for each sensor; by default none.

    Raises
    ------
    InputError
        When shapes differ, a value is not finite, a scale factor is not positive, or an orientation is none.
    """

    scale_factor: FloatArray
    non_orthogonality: FloatArray
    bias_T: FloatArray
    misalignment: FloatArray
    orientation: FloatArray = field(default_factory=lambda: ORIENTATIONS[0])

    def __post_init__(self) -> None:
        """Check shapes and values."""
        for each in fields(self)[:4]:
            value = np.atleast_2d(np.asarray(getattr(self, each.name), dtype=float))
            object.__setattr__(self, each.name, value)
            if value.shape != self.scale_factor.shape or value.shape[1] != 3:
                raise InputError(f"{each.name} must have the shape (sensors, 3) of the others, not {value.shape}")
            if not np.isfinite(value).all():
                raise InputError(f"{each.name} contains a value that is not finite")
        if not (self.scale_factor > 0).all():
            raise InputError("scale factors must be positive: turn a reversed axis round before")
        orientation = np.asarray(self.orientation, dtype=float)
        is_known = (ORIENTATIONS[None] == orientation.reshape(-1, 1, 3, 3)).all(axis=(2, 3)).any(axis=1)
        for sensor, is_one in enumerate(is_known, start=1):
            if not is_one:
                raise InputError(
                    f"the orientation of sensor {sensor} must exchange and reverse axes and stay right-handed: "
                    "reverse one axis more or less, or exchange two"
                )
        object.__setattr__(self, "orientation", np.broadcast_to(orientation, (self.sensor_count, 3, 3)))

    @classmethod
    def none(cls, sensor_count: int) -> "SensorErrors":
        """Return the errors of perfect sensors."""
        zero = np.zeros((sensor_count, 3))
        return cls(np.ones((sensor_count, 3)), zero, zero, zero)

    @classmethod
    def from_matrix(
        cls, matrix: FloatArray, bias_T: FloatArray, orientation: FloatArray | None = None
    ) -> "SensorErrors":
        """Split matrices D Λ into scale factors, non-orthogonality and misalignment.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            From the field in the array frame to the readings without bias; right-handed.
        bias_T : (K, 3) array
            Reading in zero field, tesla.
        orientation : (K, 3, 3) array, optional
            Of the sensors, where it is known; by default there is none but where β would exceed 45°.

        Raises
        ------
        InputError
            When a matrix is singular or its sensor left-handed.
        """
        for sensor, value in enumerate(np.linalg.det(matrix)):
            if not value > 0:
                raise InputError(f"sensor {sensor + 1} has left-handed or dependent axes: check their order and signs")
        # The rows in reverse order turn QR into RQ: D upper triangular with a positive diagonal.
        q, r = np.linalg.qr(np.swapaxes(matrix[:, ::-1], 1, 2))
        sign = np.sign(np.diagonal(r, axis1=1, axis2=2))
        upper = np.swapaxes(r * sign[:, :, None], 1, 2)[:, ::-1, ::-1]
        rotation = np.swapaxes(q * sign[:, None, :], 1, 2)[:, ::-1]
        scale = norm(upper, axis=2)
        theta = np.arcsin(upper[:, 0, 2] / scale[:, 0])
        phi = np.arctan2(upper[:, 0, 1], upper[:, 0, 0])
        psi = np.arctan2(upper[:, 1, 2], upper[:, 1, 1])
        straight = cls(scale, np.stack([theta, phi, psi], 1), bias_T, np.zeros_like(bias_T))
        return straight.with_rotation(rotation, orientation)

    def with_rotation(self, rotation: FloatArray, orientation: FloatArray | None = None) -> "SensorErrors":
        """Return the errors of sensors that are mounted by other rotations Λ.

        Parameters
        ----------
        rotation : (K, 3, 3) array
            From the array frame to each sensor's orthogonal frame.
        orientation : (K, 3, 3) array, optional
            Of the sensors; by default none, or the nearest one where β would exceed 45°.
        """
        if orientation is None:
            orientation = _orientations_of(rotation)
        small = rotation @ np.swapaxes(orientation, 1, 2)
        alpha = np.arctan2(small[:, 1, 2], small[:, 2, 2])
        beta = -np.arcsin(np.clip(small[:, 0, 2], -1, 1))
        gamma = np.arctan2(small[:, 0, 1], small[:, 0, 0])
        return replace(self, misalignment=np.stack([alpha, beta, gamma], 1), orientation=orientation)

    @classmethod
    def from_vector(cls, vector: FloatArray, orientation: FloatArray = ORIENTATIONS[0]) -> "SensorErrors":
        """Make the errors from K rows of twelve parameters, the inverse of ``to_vector``, and orientations."""
        scale, angles, bias_T, misalignment = np.split(np.asarray(vector, dtype=float).reshape(-1, 12), 4, axis=1)
        return cls(scale, angles, bias_T, misalignment, orientation)

    def to_vector(self) -> FloatArray:
        """Return the (K, 12) parameters in the order of ``PARAMETER_NAMES``."""
        return np.concatenate([self.scale_factor, self.non_orthogonality, self.bias_T, self.misalignment], axis=1)

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self.scale_factor)

    @cached_property
    def measurement(self) -> FloatArray:
        """(K, 3, 3) upper triangular matrices D of scale factors and non-orthogonality (Wu 2025 eq. 3)."""
        (sx, sy, sz), (theta, phi, psi) = self.scale_factor.T, self.non_orthogonality.T
        matrix = np.zeros((self.sensor_count, 3, 3))
        matrix[:, 0, 0] = sx * np.cos(theta) * np.cos(phi)
        matrix[:, 0, 1] = sx * np.cos(theta) * np.sin(phi)
        matrix[:, 0, 2] = sx * np.sin(theta)
        matrix[:, 1, 1] = sy * np.cos(psi)
        matrix[:, 1, 2] = sy * np.sin(psi)
        matrix[:, 2, 2] = sz
        return matrix

    @cached_property
    def rotation(self) -> FloatArray:
        """(K, 3, 3) passive rotations Λ from the array frame to each sensor's orthogonal frame."""
        about_x, about_y, about_z = self._turns
        return np.asarray(about_x @ about_y @ about_z @ self.orientation)

    @cached_property
    def _turns(self) -> FloatArray:
        """(3, K, 3, 3) passive rotations by α about x, by β about y and by γ about z."""
        return np.stack([_rotate(axis, angle) for axis, angle in enumerate(self.misalignment.T)])

    @cached_property
    def turning_axes(self) -> FloatArray:
        """(K, 3, 3) columns a of the changes dΛ = -[a]× Λ by α, β and γ."""
        about_x, about_y, _ = self._turns
        columns = [np.broadcast_to(np.eye(3)[:, 0], (self.sensor_count, 3)), about_x[:, :, 1]]
        return np.stack([*columns, (about_x @ about_y)[:, :, 2]], axis=2)

    @cached_property
    def matrix(self) -> FloatArray:
        """(K, 3, 3) matrices D Λ from the field in the array frame to the readings without bias."""
        return self.measurement @ self.rotation

    @cached_property
    def inverse(self) -> FloatArray:
        """(K, 3, 3) matrices from readings without bias to the field in the array frame."""
        return np.asarray(inv(self.matrix))

    @property
    def joint_inverse(self) -> FloatArray:
        """(3K, 3K) matrix from the readings of all sensors without bias to the fields at them, in the array frame."""
        size = 3 * self.sensor_count
        return np.asarray(np.einsum("kl,kij->kilj", np.eye(self.sensor_count), self.inverse).reshape(size, size))

    def distort(self, field_T: FloatArray) -> FloatArray:
        """Return the (N, K, 3) readings of the true fields (N, K, 3) at the sensors, or (N, 3) uniform."""
        if field_T.ndim == 2:
            field_T = field_T[:, None, :]
        everywhere = np.broadcast_to(field_T, (len(field_T), self.sensor_count, 3))
        return np.asarray(np.einsum("kij,nkj->nki", self.matrix, everywhere) + self.bias_T)

    def restore(self, readings_T: FloatArray) -> FloatArray:
        """Return the (N, K, 3) fields in the array frame from raw readings (N, K, 3)."""
        unbiased = np.swapaxes(readings_T - self.bias_T, 0, 1)
        return np.swapaxes(unbiased @ np.swapaxes(self.inverse, 1, 2), 0, 1)

    def jacobian(self) -> FloatArray:
        """Return the (K, 3, 4, 12) derivatives of [D Λ | o] by the parameters in the order of ``PARAMETER_NAMES``."""
        (sx, sy, _), (theta, phi, psi) = self.scale_factor.T, self.non_orthogonality.T
        measurement, rotation = self.measurement, self.rotation
        derivative = np.zeros((self.sensor_count, 12, 3, 4))
        matrix = derivative[..., :3]
        for axis in range(3):
            matrix[:, axis, axis] = measurement[:, axis] / self.scale_factor[:, axis, None]
        matrix[:, 3, 0] = np.stack(
            [-sx * np.sin(theta) * np.cos(phi), -sx * np.sin(theta) * np.sin(phi), sx * np.cos(theta)], 1
        )
        matrix[:, 4, 0, 0], matrix[:, 4, 0, 1] = -measurement[:, 0, 1], measurement[:, 0, 0]
        matrix[:, 5, 1, 1], matrix[:, 5, 1, 2] = -sy * np.sin(psi), sy * np.cos(psi)
        matrix[:, :6] = matrix[:, :6] @ rotation[:, None]
        derivative[:, 6:9, :, 3] = np.eye(3)
        about_x, about_y, about_z = self._turns
        # A passive rotation by an angle has the derivative -[axis]× times itself.
        matrix[:, 9] = measurement @ -CROSS[0] @ rotation
        matrix[:, 10] = measurement @ about_x @ -CROSS[1] @ about_y @ about_z @ self.orientation
        matrix[:, 11] = measurement @ about_x @ about_y @ about_z @ -CROSS[2] @ self.orientation
        return np.moveaxis(derivative, 1, 3)


CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2)
"""(3, 3, 3) matrices of the cross products with the unit vectors: ``CROSS[0] @ v`` is x × v."""


def crossing(vectors: FloatArray) -> FloatArray:
    """Return the matrices (…, 3, 3) of the cross product with vectors (…, 3) from the left."""
    return np.tensordot(vectors, CROSS, 1)


def orientation_to_axes(orientation: FloatArray) -> list[str]:
    """Return which axis of the array each axis of a sensor points along: for none ``x``, ``y``, ``z``.

    Parameters
    ----------
    orientation : (3, 3) array
        One of `ORIENTATIONS`, or a mirror image of one.
    """
    return [f"{'-' if row.sum() < 0 else ''}{'xyz'[np.abs(row).argmax()]}" for row in orientation]


def orientation_from_axes(axes: Sequence[str]) -> FloatArray:
    """Return the (3, 3) orientation of a sensor from what `orientation_to_axes` says of it.

    Parameters
    ----------
    axes : sequence of str
        Three of ``x``, ``y``, ``z``, ``-x``, ``-y``, ``-z``.
    """
    rows = np.zeros((3, 3))
    for row, axis in zip(rows, axes, strict=True):
        row["xyz".index(axis[-1])] = -1 if len(axis) > 1 else 1
    return rows


def _orientations_of(rotation: FloatArray) -> FloatArray:
    """Return the orientations (K, 3, 3) nearest to rotations where their β is steep, and none elsewhere."""
    overlap = np.einsum("kij,oij->ko", rotation, ORIENTATIONS)
    # np.pi / 4: largest β without an orientation, radians: half way to where α and γ are one; their errors grow by 1.4
    # there.
    is_steep = np.abs(rotation[:, 0, 2]) > np.sin(np.pi / 4)
    return ORIENTATIONS[np.where(is_steep, overlap.argmax(axis=1), 0)]


def _rotate(axis: int, angle: FloatArray) -> FloatArray:
    """Return the (K, 3, 3) passive rotations about an axis."""
    rotation = np.zeros((len(angle), 3, 3))
    second, third = (axis + 1) % 3, (axis + 2) % 3
    rotation[:, axis, axis] = 1
    rotation[:, second, second] = rotation[:, third, third] = np.cos(angle)
    rotation[:, second, third] = np.sin(angle)
    rotation[:, third, second] = -rotation[:, second, third]
    return rotation


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """Residuals of every sample in a uniform field of known intensity.

    Parameters
    ----------
    sensor_intensity_T : (N, K) array
        |b_i| - s for each sensor, tesla; NaN where there is no reference.
    center_intensity_T : (N,) array
        The same for the centre vector, tesla.
    tensor_T_per_m : (N, 5) array
        Components xx, xy, xz, yy, yz, T/m; NaN where the geometry has no gradient.

    Examples
    --------
    >>> from tam_calibration import calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> series = calibrate(made.recording, made.scenario.array).residuals(made.recording)
    >>> series.sensor_intensity_T.shape, series.center_intensity_T.shape, series.tensor_T_per_m.shape
    ((360, 4), (360,), (360, 5))
    """

    sensor_intensity_T: FloatArray
    center_intensity_T: FloatArray
    tensor_T_per_m: FloatArray


@dataclass(frozen=True, eq=False)
class Residuals:
    """Root mean square residuals of corrected readings in a uniform field of known intensity.

    Parameters
    ----------
    sensor_intensity_T : (K,) array
        RMS of |b_i| - s for each sensor (Wu 2025 eqs. 14, 15), tesla.
    center_intensity_T : float
        The same for the centre vector, tesla.
    tensor_T_per_m : (5,) array
        RMS of the components xx, xy, xz, yy, yz, T/m; NaN where the geometry has no gradient.
    """

    sensor_intensity_T: FloatArray
    center_intensity_T: float
    tensor_T_per_m: FloatArray

    @property
    def sensors_rms_T(self) -> float:
        """RMS of |b_i| - s over all sensors, tesla."""
        return float(np.sqrt(np.mean(self.sensor_intensity_T**2)))

    @property
    def tensor_rmse_T_per_m(self) -> float:
        """Root of the summed squares of the five components, e_T of Wu 2025 eqs. 16, 17."""
        return float(norm(self.tensor_T_per_m))


def residual_series(errors: SensorErrors, array: Array, recording: Recording, intensity_T: float) -> ResidualSeries:
    """Return the residuals of the samples of a recording in a uniform field, corrected with given errors.

    Parameters
    ----------
    errors : SensorErrors
        By which the readings are corrected.
    array : Array
        Geometry of the K sensors.
    recording : Recording
        Raw readings.
    intensity_T : float
        Intensity of the field where the recording has no scalar channel, tesla.
    """
    intensity, tensor = ResidualSums(errors, array, intensity_T).of_samples(recording)
    return ResidualSeries(intensity[:-1].T, intensity[-1], tensor.T)


class ResidualSums:
    """The sums of the squared residuals of corrected readings, block by block, as in ``residual_series``.

    Parameters
    ----------
    errors : SensorErrors
        What the readings are corrected with.
    array : Array
        Geometry.
    intensity_T : float
        Stands in where there is no scalar channel; NaN counts no intensity there.
    """

    def __init__(self, errors: SensorErrors, array: Array, intensity_T: float) -> None:
        self._intensity_T, self._sensors = intensity_T, errors.sensor_count
        unmix = errors.joint_inverse
        self._map = np.concatenate([unmix, array.operator[[0, 1, 2, *TENSOR_OUTPUTS]] @ unmix])
        self._offset = -self._map @ errors.bias_T.reshape(-1, 1)
        self._intensity, self._known = np.zeros(self._sensors + 1), 0
        self._tensor, self._all = np.zeros(len(TENSOR_OUTPUTS)), 0

    @classmethod
    def of(cls, errors: SensorErrors, array: Array, source: SampleSource, intensity_T: float) -> "ResidualSums":
        """Return the sums of all samples of a recording."""
        sums = cls(errors, array, intensity_T)
        for block in source.blocks():
            sums.add(block)
        return sums

    def of_samples(self, block: Block | Recording) -> tuple[FloatArray, FloatArray]:
        """Return each sample's residuals: of intensities (K + 1, n), NaN without a reference, and the tensor (5, n)."""
        outputs = self._map @ block.readings_T.reshape(len(block.readings_T), -1).T
        outputs += self._offset
        vectors, tensor = np.split(outputs, [3 * self._sensors + 3])
        residuals = np.sqrt((vectors**2).reshape(self._sensors + 1, 3, -1).sum(axis=1))
        residuals -= self._intensity_T if block.scalar_T is None else block.scalar_T
        return residuals, tensor

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        residuals, tensor = self.of_samples(block)
        known = np.isfinite(residuals[-1])
        if not known.all():
            residuals = residuals[:, known]
        self._intensity += np.einsum("kn,kn->k", residuals, residuals)
        self._known += residuals.shape[1]
        self._tensor += np.einsum("cn,cn->c", tensor, tensor)
        self._all += tensor.shape[1]

    def plus(self, other: "ResidualSums") -> "ResidualSums":
        """Return the sums of the samples of both, which other errors may have corrected."""
        total = copy(self)
        total._intensity, total._known = self._intensity + other._intensity, self._known + other._known
        total._tensor, total._all = self._tensor + other._tensor, self._all + other._all
        return total

    def result(self) -> Residuals:
        """Return the root mean squares of what was added."""
        intensity = np.sqrt(self._intensity / self._known)
        return Residuals(intensity[:-1], float(intensity[-1]), np.sqrt(self._tensor / self._all))


def measure_residuals(errors: SensorErrors, array: Array, source: SampleSource, intensity_T: float) -> Residuals:
    """Return the root mean square residuals of a recording, as in ``residual_series``.

    Parameters
    ----------
    errors : SensorErrors
        By which the readings are corrected.
    array : Array
        Geometry of the K sensors.
    source : SampleSource
        Raw readings.
    intensity_T : float
        Intensity of the field where there is no scalar channel, tesla.
    """
    return ResidualSums.of(errors, array, source, intensity_T).result()


def noise_floor(errors: SensorErrors, array: KnownNoiseArray, scalar_noise_T: float) -> Residuals:
    """Return the residuals that sensor noise alone leaves, whatever the calibration.

    The noise of an intensity is the mean over all directions of the noise along the field.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors, which turn the noise of readings into that of fields.
    array : KnownNoiseArray
        Geometry, and the noise of each sensor's axes.
    scalar_noise_T : float
        Standard deviation of the reference intensity, tesla; 0 where it is the true one.
    """
    sensor_variance = array.vector_noise_T**2 * (errors.inverse**2).sum(axis=(1, 2)) / 3
    output_variance = (array.operator @ errors.joint_inverse) ** 2 @ np.repeat(array.vector_noise_T**2, 3)
    return Residuals(
        np.sqrt(sensor_variance + scalar_noise_T**2),
        float(np.sqrt(output_variance[:3].mean() + scalar_noise_T**2)),
        np.sqrt(output_variance[list(TENSOR_OUTPUTS)]),
    )
