"""What a uniform field leaves open, from the field of a known source: baselines, common frame, places of the axes.

The reading of axis a of sensor k in pose n is row a of its matrix D Λ times X Rₙᵀ B(cₙ + Rₙ (s p_k + d_ka)). B is the
field of the source in the world, p_k the stated position of the sensor, s the scale of the baselines, d_ka the place of
the element of the axis beside the sensor, and X the turn from the array frame into that of the calibration so far. What
the places have in common with longer baselines counts as scale: Σ p_k · d_ka is zero.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.array import Array
from tam_calibration.errors import SensorErrors
from tam_calibration.localization.dipole import Dipole
from tam_calibration.localization.loop import Loop
from tam_calibration.localization.poses import Poses
from tam_calibration.problems import InputError, Refused
from tam_calibration.units import FloatArray

_STEPS = 30
_SMALLEST_STEP = 1e-12
_LARGEST_CONDITION = 1e6
_OTHER_SOURCE = (
    "the readings cannot be those of the stated source: check its position, axis, strength and radius, and the poses"
)
_UNDETERMINED = (
    "these poses do not determine baselines, frame and places of the axes: turn the array through more headings, about "
    "more than one axis if need be, or nearer to the source"
)


@dataclass(frozen=True, eq=False)
class SourceCalibration:
    """What a known source showed of an array.

    Parameters
    ----------
    baseline_scale : float
        True distances of the sensors from the centre over the stated ones.
    rotation : (3,) array
        Rotation vector that turns vectors of the array frame into the frame of the calibration before, radians.
    axis_offsets_m : (K, 3, 3) array
        Places of the elements of axis x, y, z of each sensor beside its scaled position, array frame, metres; one place
        in common is an error of the array's stated centre.
    covariance : (4 + 9 K, 4 + 9 K) array
        Of scale, rotation and offsets, SI: of the noise of the amplitudes, the calibration before and the source taken
        as exact. Its rank is one less.
    chi_square : float
        Sum of the squared residuals over the noise.
    degrees_of_freedom : int
        What it is expected to be.
    """

    baseline_scale: float
    rotation: FloatArray
    axis_offsets_m: FloatArray
    covariance: FloatArray
    chi_square: float
    degrees_of_freedom: int

    @property
    def parameters(self) -> FloatArray:
        """(4 + 9 K,) scale, rotation and offsets."""
        return np.concatenate([[self.baseline_scale], self.rotation, self.axis_offsets_m.ravel()])

    @property
    def standard_errors(self) -> FloatArray:
        """(4 + 9 K,) standard errors of ``parameters``."""
        errors: FloatArray = np.sqrt(np.diag(self.covariance))
        return errors

    def array_of(self, stated: Array) -> Array:
        """Return the array with its true baselines, and the places of its axes."""
        return replace(stated, positions_m=self.baseline_scale * stated.positions_m, axis_offsets_m=self.axis_offsets_m)

    def errors_of(self, errors: SensorErrors) -> SensorErrors:
        """Return errors in the array frame from those in the frame of the calibration before."""
        return SensorErrors.from_matrix(errors.matrix @ _matrix(self.rotation), errors.bias_T)


def calibrate_by_source(
    amplitudes_T: FloatArray,
    noise_T: float | FloatArray,
    source: Dipole | Loop,
    poses: Poses,
    errors: SensorErrors,
    array: Array,
) -> SourceCalibration:
    """Fit baseline scale, common rotation and axis offsets.

    Parameters
    ----------
    amplitudes_T : (N, K, 3) array
        Raw readings of the source alone in N poses, such as demodulated amplitudes, tesla; of each pose the sign of all
        together is open.
    noise_T : float or (N, K, 3) array
        Standard deviation of the amplitudes, tesla.
    source : Dipole or Loop
        Known, in the world.
    poses : Poses
        Of the array in the world.
    errors : SensorErrors
        From a calibration in a uniform field.
    array : Array
        As stated.

    Returns
    -------
    SourceCalibration
        With standard errors.

    Raises
    ------
    InputError
        When a shape is wrong or a value not finite or positive.
    Refused
        When the poses do not determine the parameters.
    """
    readings, noise = _check(amplitudes_T, noise_T, poses, array)
    model, allowed = _Model(source, poses, errors, array), _allowed(array)
    parameters, rotation = np.zeros(len(allowed)), np.eye(3)
    parameters[0], is_moved = 1.0, False
    for _ in range(_STEPS):
        predicted, derivative = model.predict(parameters[0], rotation, parameters[4:].reshape(-1, 3, 3))
        signs = np.sign(np.sum(readings * predicted, axis=(1, 2)))[:, None, None]
        residual = ((signs * readings - predicted) / noise).ravel()
        design = (derivative / noise[..., None]).reshape(len(residual), -1) @ allowed
        scale = norm(design, axis=0)
        left, size, right = np.linalg.svd(design / np.where(scale > 0, scale, 1.0), full_matrices=False)
        if len(residual) < design.shape[1] or size[-1] * _LARGEST_CONDITION < size[0]:
            raise Refused(_OTHER_SOURCE if is_moved else _UNDETERMINED)
        step = allowed @ (right.T @ ((left.T @ residual) / size) / scale)
        parameters = parameters + step
        rotation, is_moved = _matrix(step[1:4]) @ rotation, True
        if norm(design @ (allowed.T @ step)) < _SMALLEST_STEP * norm(readings / noise):
            break
    else:
        raise Refused(_OTHER_SOURCE)
    root = allowed @ (right.T / size / scale[:, None])
    return SourceCalibration(
        float(parameters[0]),
        _vector(rotation),
        parameters[4:].reshape(-1, 3, 3),
        root @ root.T,
        float(residual @ residual),
        residual.size - allowed.shape[1],
    )


def _allowed(array: Array) -> FloatArray:
    """Return orthonormal directions (4 + 9 K, 3 + 9 K) of the parameters in which the offsets hold no scale."""
    scaling = np.repeat(array.positions_m[:, None], 3, axis=1).ravel()
    basis = np.eye(4 + len(scaling))
    if norm(scaling) == 0:
        raise InputError("all sensors sit at the centre: there is no baseline to calibrate")
    # The complement of the scaling direction: all but the first column of an orthogonal matrix that begins with it.
    orthogonal, _ = np.linalg.qr(np.column_stack([scaling, np.eye(len(scaling))]))
    basis[4:, 4:] = orthogonal[:, : len(scaling)]
    return np.delete(basis, 4, axis=1)


@dataclass(frozen=True, eq=False)
class _Model:
    """What the sensors read of the source."""

    source: Dipole | Loop
    poses: Poses
    errors: SensorErrors
    array: Array

    def predict(self, scale: float, rotation: FloatArray, offsets_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the readings (N, K, 3) and their derivatives (N, K, 3, 4 + 9 K)."""
        turn, positions = self.poses.matrix, self.array.positions_m
        elements = scale * positions[:, None] + offsets_m
        world = self.poses.position_m[:, None, None] + np.einsum("nij,kaj->nkai", turn, elements)
        field = np.einsum("nji,nkaj->nkai", turn, self.source.field_T(world))
        gradient = np.einsum("nji,nkajl,nlm->nkaim", turn, self.source.gradient_T_per_m(world), turn, optimize=True)
        rows = self.errors.matrix
        turned = field @ rotation.T
        by_place = np.einsum("kai,ij,nkajm->nkam", rows, rotation, gradient, optimize=True)
        derivative = np.zeros((*field.shape[:3], 4 + 9 * len(positions)))
        derivative[..., 0] = np.einsum("nkam,km->nka", by_place, positions)
        # A further turn by ω adds ω × b, of which the row takes b × row · ω.
        derivative[..., 1:4] = np.cross(turned, rows)
        own = derivative[..., 4:].reshape(*field.shape[:3], len(positions), 3, 3)
        for sensor, axis in np.ndindex(*field.shape[1:3]):
            own[:, sensor, axis, sensor, axis] = by_place[:, sensor, axis]
        return np.einsum("kai,nkai->nka", rows, turned), derivative


def _check(
    amplitudes_T: FloatArray, noise_T: float | FloatArray, poses: Poses, array: Array
) -> tuple[FloatArray, FloatArray]:
    readings = np.asarray(amplitudes_T, dtype=float)
    shape = (len(poses.attitude), array.sensor_count, 3)
    if readings.shape != shape:
        raise InputError(f"the amplitudes must have the shape {shape} of poses and sensors, not {readings.shape}")
    noise = np.broadcast_to(np.asarray(noise_T, dtype=float), shape)
    if not (np.isfinite(readings).all() and np.isfinite(noise).all() and (noise > 0).all()):
        raise InputError("every amplitude must be finite, and its noise a positive number")
    return readings, noise


def _matrix(vector: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    matrix: FloatArray = Rotation.from_rotvec(vector).as_matrix()
    return matrix


def _vector(matrix: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    vector: FloatArray = Rotation.from_matrix(matrix).as_rotvec()
    return vector
