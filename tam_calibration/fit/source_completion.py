"""A calibration from a uniform field, completed with what an alternating source shows in poses at rest."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.correction.calibration import Calibration, KnownSource
from tam_calibration.fit.source_calibration import SourceCalibration, calibrate_by_source
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.sources.demodulation import background_of, demodulate
from tam_calibration.sources.dipole import Source
from tam_calibration.sources.poses import Poses

_STILL = from_degrees(0.2)
"""An attitude that stays within this angle of its first is one pose, radians."""
FEWEST_PERIODS = 10.0
"""A pose lasts at least so many periods of the source."""


@dataclass(frozen=True, eq=False)
class PoseAmplitudes:
    """What the sensors read of a source in N poses.

    Parameters
    ----------
    time_s : (N,) array
        Middles of the poses, seconds.
    poses : Poses
        Of the array, its centre at the origin of the world.
    amplitudes_T : (N, K, 3) array
        Raw, tesla; of each pose the sign of all together is open.
    noise_T : (N, K, 3) array
        Their standard errors.
    """

    time_s: FloatArray
    poses: Poses
    amplitudes_T: FloatArray
    noise_T: FloatArray


def amplitudes_of(recording: Recording, frequency_hz: float) -> PoseAmplitudes:
    """Return the amplitudes of a source in each pose of a recording.

    Parameters
    ----------
    recording : Recording
        Of an array that was turned and stood still in turn, with attitude.
    frequency_hz : float
        Of the source.

    Raises
    ------
    InputError
        When there is no attitude, or no pose lasts long enough.
    """
    if recording.attitude is None:
        raise InputError("the recording of the source has no attitude: without it the poses are not known")
    recording = recording.take(np.flatnonzero(np.isfinite(recording.attitude).all(axis=1)))
    assert recording.attitude is not None
    stretches = poses_of(recording, frequency_hz)
    if not stretches:
        raise InputError(
            f"the array stood still nowhere for {FEWEST_PERIODS / frequency_hz:g} s, {FEWEST_PERIODS:g} periods of the "
            f"source at {frequency_hz:g} Hz: let it rest in each heading"
        )
    found = [_demodulate(recording.take(part), frequency_hz) for part in stretches]
    middles = [(part.start + part.stop) // 2 for part in stretches]
    amplitudes, noise = (np.array(values) for values in zip(*found, strict=True))
    poses = Poses.headings(recording.attitude[middles])
    return PoseAmplitudes(recording.time_s[middles], poses, amplitudes, noise)


def poses_of(recording: Recording, frequency_hz: float) -> list[slice]:
    """Return the stretches of a recording, its attitude known throughout, in which the array stood still.

    Parameters
    ----------
    recording : Recording
        Its attitude known in every sample.
    frequency_hz : float
        Of the source: a stretch lasts at least ``FEWEST_PERIODS`` of its periods.
    """
    assert recording.attitude is not None
    shortest = FEWEST_PERIODS / frequency_hz
    return [part for part in _still(recording.attitude) if np.ptp(recording.time_s[part]) >= shortest]


def _still(attitude: FloatArray) -> list[slice]:
    """Return the stretches in which the attitude (N, 4) stays where it is at the first sample."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    stretches, start = [], 0
    while start < len(unit):
        moved = np.abs(unit[start:] @ unit[start]) < np.cos(_STILL / 2)
        length = int(moved.argmax()) if moved.any() else len(moved)
        stretches.append(slice(start, start + length))
        start += length
    return stretches


def _demodulate(pose: Recording, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    shape = (pose.sensor_count, 3)
    channels = pose.readings_T.reshape(pose.sample_count, -1)
    found = demodulate(pose.time_s, channels, frequency_hz, background_of(pose.time_s))
    return found.amplitude.reshape(shape), found.standard_errors.reshape(shape)


_FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded: a source of known place, axis and strength showed how the "
    "frame of the calibration in a uniform field is turned against it, how long the baselines are, and where the "
    "elements of the axes sit."
)
_LARGEST_CHI_SQUARE = 10.0
"""Above this many times what noise leaves, the source is not the one that is stated."""


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
        seen.amplitudes_T, seen.noise_T, source, seen.poses, calibration.errors, calibration.array
    )
    reduced = found.chi_square / found.degrees_of_freedom
    if reduced > _LARGEST_CHI_SQUARE:
        raise Refused(
            f"the readings differ from those of the stated source by {reduced**0.5:.1f} times their noise: check its "
            "position, axis, strength and radius, and the gain of the sensors at its frequency"
        )
    sensors = len(calibration.array.positions_m)
    errors = found.errors_of(calibration.errors)
    return replace(
        calibration,
        array=found.array_of(calibration.array),
        errors=errors,
        covariance=_turned_covariance(calibration, found, errors),
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


def _turned_covariance(calibration: Calibration, found: SourceCalibration, errors: SensorErrors) -> FloatArray | None:
    """Return the covariance of the errors in the turned frame: of the calibration before, and of the turn itself."""
    if calibration.covariance is None:
        return None
    from scipy.spatial.transform import Rotation

    sensors = errors.sensor_count
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec(found.rotation).as_matrix()
    # Rows [D Λ | o] of each sensor: before by its parameters, turned, and back to the parameters after.
    before = np.einsum("kiap,ab->kibp", calibration.errors.jacobian(), turn).reshape(sensors, 12, 12)
    to_parameters = np.linalg.inv(errors.jacobian().reshape(sensors, 12, 12))
    change = np.zeros((12 * sensors, 12 * sensors))
    by_turn = np.zeros((12 * sensors, 3))
    for sensor in range(sensors):
        own = slice(12 * sensor, 12 * sensor + 12)
        change[own, own] = to_parameters[sensor] @ before[sensor]
        # A further turn δ of the frame before makes D Λ [δ]× X of D Λ X.
        rows = np.zeros((3, 4, 3))
        rows[:, :3] = np.einsum("ij,jkd,kl->ild", calibration.errors.matrix[sensor], _CROSS, turn[:3, :3])
        by_turn[own] = to_parameters[sensor] @ rows.reshape(12, 3)
    covariance: FloatArray = (
        change @ calibration.covariance @ change.T + by_turn @ found.covariance[1:4, 1:4] @ by_turn.T
    )
    return covariance


_CROSS = np.swapaxes(np.cross(np.eye(3)[:, None], np.eye(3)[None]), 0, 2)
"""(3, 3, 3) numbers [j, k, d] of the matrix [δ]× by component d of δ."""
