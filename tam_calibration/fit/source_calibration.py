"""Baselines, common frame and places of the axes of an array, fitted to the field of a known source.

What the places of the axes have in common with longer baselines counts as scale: Σ p_k · d_ka is zero, p_k the stated
position of sensor k and d_ka the place of its axis a.

A uniform field leaves baselines, common frame and places of the axes open. ``complete`` adds what an alternating source
shows of them in poses at rest.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Normal, scaled
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import KnownSource
from tam_calibration.fit.information import descend, inverted
from tam_calibration.fit.prior import turned
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.mounting import matrices_of, rotation_matrix
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import amplitudes_of
from tam_calibration.sources.dipole import Source

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
        Places of the elements of axis x, y, z of each sensor from its scaled position, array frame, metres; one place
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
        return np.sqrt(np.diag(self.covariance))

    def array_of(self, stated: KnownNoiseArray) -> KnownNoiseArray:
        """Return the array with its true baselines, and the places of its axes."""
        return replace(stated, positions_m=self.baseline_scale * stated.positions_m, axis_offsets_m=self.axis_offsets_m)


def calibrate_by_source(
    amplitudes_T: FloatArray,
    noise_T: float | FloatArray,
    source: Source,
    attitude: FloatArray,
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
    source : Source
        Known, in the world.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world, in whose origin the array's centre is.
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
    from scipy.spatial.transform import Rotation

    readings, noise = _check(amplitudes_T, noise_T, attitude, array)
    to_world = matrices_of(attitude)
    allowed, start = _allowed(array), _Point(1.0, np.eye(3), np.zeros((array.sensor_count, 3, 3)))

    def linearize(point: _Point) -> Normal:
        predicted, derivative = _predict(source, to_world, errors, array, point)
        signs = np.sign(np.sum(readings * predicted, axis=(1, 2)))[:, None, None]
        residual = ((signs * readings - predicted) / noise).ravel()
        design = (derivative / noise[..., None]).reshape(len(residual), -1)
        return Normal(design.T @ design, design.T @ residual, float(residual @ residual), residual.size)

    def normal_at(point: _Point) -> tuple[FloatArray, FloatArray, None]:
        inside = linearize(point).by(allowed)
        is_seen = inside.count >= len(inside.score) and (np.diag(inside.information) > 0).all()
        # Condition of the scaled design from which a parameter is open: its error is a thousand times the usual.
        if not is_seen or np.linalg.cond(scaled(inside.information)[0]) > 1e6**2:
            raise InputError(_UNDETERMINED if point is start else _OTHER_SOURCE)
        return inside.information, inside.score, None

    try:
        end, _ = descend(normal_at, lambda point, step: point.moved(allowed @ step), start)
    except InputError as problem:
        raise Refused(str(problem)) from None
    except Refused:
        raise Refused(_OTHER_SOURCE) from None
    last, rotation = linearize(end), Rotation.from_matrix(end.rotation).as_rotvec()
    covariance, freedom = inverted(last.information, allowed), readings.size - allowed.shape[1]
    return SourceCalibration(end.scale, rotation, end.offsets_m, covariance, last.energy, freedom)


class _Point(NamedTuple):
    """Scale of the baselines, turn (3, 3) of the common frame and places (K, 3, 3) of the axes."""

    scale: float
    rotation: FloatArray
    offsets_m: FloatArray

    def moved(self, step: FloatArray) -> "_Point":
        """Return the point after a step (4 + 9 K,)."""
        offsets = self.offsets_m + step[4:].reshape(-1, 3, 3)
        return _Point(self.scale + float(step[0]), rotation_matrix(step[1:4]) @ self.rotation, offsets)


def _predict(
    source: Source, turn: FloatArray, errors: SensorErrors, array: Array, point: _Point
) -> tuple[FloatArray, FloatArray]:
    """Return the readings (N, K, 3) of a source in tesla and their derivatives (N, K, 3, 4 + 9 K)."""
    positions = array.positions_m
    elements = point.scale * positions[:, None] + point.offsets_m
    world = np.einsum("nij,kaj->nkai", turn, elements)
    field = np.einsum("nji,nkaj->nkai", turn, source.field_T(world))
    gradient = np.einsum("nji,nkajl,nlm->nkaim", turn, source.gradient_T_per_m(world), turn, optimize=True)
    rows = errors.matrix
    turned_field = field @ point.rotation.T
    by_place = np.einsum("kai,ij,nkajm->nkam", rows, point.rotation, gradient, optimize=True)
    derivative = np.zeros((*field.shape[:3], 4 + 9 * len(positions)))
    derivative[..., 0] = np.einsum("nkam,km->nka", by_place, positions)
    # A further turn by ω adds ω × b, of which the row takes b × row · ω.
    derivative[..., 1:4] = np.cross(turned_field, rows)
    own = derivative[..., 4:].reshape(*field.shape[:3], len(positions), 3, 3)
    for sensor, axis in np.ndindex(*field.shape[1:3]):
        own[:, sensor, axis, sensor, axis] = by_place[:, sensor, axis]
    return np.einsum("kai,nkai->nka", rows, turned_field), derivative


def _allowed(array: Array) -> FloatArray:
    """Return orthonormal directions (4 + 9 K, 3 + 9 K) of the parameters in which the offsets hold no scale."""
    from scipy.linalg import block_diag

    scaling = np.repeat(array.positions_m[:, None], 3, axis=1).ravel()
    if norm(scaling) == 0:
        raise InputError("all sensors sit at the centre: there is no baseline to calibrate")
    # The complement of the scaling direction: all but the first column of an orthogonal matrix that begins with it.
    across = np.linalg.qr(scaling[:, None], mode="complete")[0][:, 1:]
    return np.asarray(block_diag(np.eye(4), across))


def _check(
    amplitudes_T: FloatArray, noise_T: float | FloatArray, attitude: FloatArray, array: Array
) -> tuple[FloatArray, FloatArray]:
    readings = np.asarray(amplitudes_T, dtype=float)
    shape = (len(attitude), array.sensor_count, 3)
    if readings.shape != shape:
        raise InputError(f"the amplitudes must have the shape {shape} of poses and sensors, not {readings.shape}")
    noise = np.broadcast_to(np.asarray(noise_T, dtype=float), shape)
    if not (np.isfinite(readings).all() and np.isfinite(noise).all() and (noise > 0).all()):
        raise InputError("every amplitude must be finite, and its noise a positive number")
    return readings, noise


_FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded. A source of known place, axis and strength showed the "
    "rotation of the calibration's frame, the length of the baselines, and the places of the elements of the axes."
)


def complete(calibration: Calibration, recording: Recording, source: Source, frequency_hz: float) -> Calibration:
    """Return a calibration with true baselines, common frame and places of the axes.

    Parameters
    ----------
    calibration : Calibration
        From a uniform field.
    recording : Recording
        Of the source: the array's centre at the origin of the world, its attitude recorded, at rest in each pose.
    source : Source
        In the world.
    frequency_hz : float
        Of the source.

    Raises
    ------
    InputError
        When the recording has no attitude or no pose, or another number of sensors.
    Refused
        When the poses do not determine the parameters, or the readings are not those of this source.
    """
    seen = amplitudes_of(recording, frequency_hz)
    found = calibrate_by_source(
        seen.amplitudes_T, seen.noise_T, source, seen.attitude, calibration.errors, calibration.array
    )
    reduced = found.chi_square / found.degrees_of_freedom
    # Reject the stated source above this ratio of the squared residuals to the noise floor.
    if reduced > 10.0:
        raise Refused(
            f"the readings differ from those of the stated source by {reduced**0.5:.3g} times their noise: check its "
            "position, axis, strength and radius, and the gain of the sensors at its frequency"
        )
    sensors = len(calibration.array.positions_m)
    errors, derivative = turned(calibration.errors, rotation_matrix(found.rotation))
    by_errors, by_turn = derivative[:, :-3], derivative[:, -3:]
    covariance = by_errors @ calibration.covariance @ by_errors.T
    covariance += by_turn @ found.covariance[1:4, 1:4] @ by_turn.T
    return replace(
        calibration,
        array=found.array_of(calibration.array),
        errors=errors,
        covariance=covariance,
        frame=_FRAME_STATEMENT,
        known_source=KnownSource(
            found.baseline_scale,
            float(found.standard_errors[0]),
            found.rotation,
            found.standard_errors[1:4],
            found.standard_errors[4:].reshape(sensors, 3, 3),
            reduced,
        ),
    )
