"""A steady source beside the regional field: from all samples of a track together, or from each by itself."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.direct_fit import SourceFit, fit_dipole
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.finite_baseline import locate_dipole
from tam_calibration.localization.sample_by_sample import Regional, locate_samples, regional_of, turned
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.localization.survey import TRACK_FRAME, WORLD_FRAME, Overall, Survey
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.poses import Poses


@dataclass(frozen=True, eq=False)
class Track:
    """A dipole that was passed.

    Parameters
    ----------
    fit : SourceFit
        The dipole in the world, from all samples.
    regional_T : (3,) array
        The uniform field of the world that was taken off, given or fitted, tesla.
    samples : EulerSolutions
        Of each sample by itself, in the array frame.
    sample_position_m : (N, 3) array
        The same in the world, metres; NaN where it was not located.
    """

    fit: SourceFit
    regional_T: FloatArray
    samples: EulerSolutions
    sample_position_m: FloatArray


def straight_track(time_s: FloatArray, start_m: FloatArray, velocity_m_per_s: FloatArray) -> FloatArray:
    """Return the positions (N, 3) of a platform that keeps its velocity, metres.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds; the platform starts at the first.
    start_m : (3,) array
        Position at the first time, metres.
    velocity_m_per_s : (3,) array
        Velocity in the same frame, m/s.

    Raises
    ------
    InputError
        When start or velocity are not three finite numbers.
    """
    start, velocity = np.asarray(start_m, dtype=float), np.asarray(velocity_m_per_s, dtype=float)
    if start.shape != (3,) or velocity.shape != (3,) or not np.isfinite([start, velocity]).all():
        raise InputError("a straight track needs a start and a velocity of three finite numbers each")
    return start + np.outer(time_s - np.asarray(time_s)[0], velocity)


def without_regional(fields_T: FloatArray, attitude: FloatArray, regional_T: FloatArray) -> FloatArray:
    """Return fields (N, K, 3) in the array frame less a field that is uniform in the world, tesla.

    Parameters
    ----------
    fields_T : (N, K, 3) array
        Calibrated readings, array frame, tesla.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    regional_T : (3,) array
        The uniform field, in the world, tesla.
    """
    from scipy.spatial.transform import Rotation

    regional: FloatArray = Rotation.from_quat(attitude).inv().apply(regional_T)
    return fields_T - regional[:, None]


def track_dipole(
    fields_T: FloatArray,
    array: Array,
    poses: Poses,
    regional_T: FloatArray | None = None,
) -> Track:
    """Find a dipole at rest from the samples of a platform that passes it.

    Parameters
    ----------
    fields_T : (N, K, 3) array
        Calibrated readings, array frame, tesla.
    array : Array
        Positions and noise of the sensors.
    poses : Poses
        Attitude and position of the array at each sample, and the noise of the attitude: 0.1° in 50 µT are 87 nT in
        all sensors alike, which is then no signal.
    regional_T : (3,) array, optional
        The uniform field of the world, tesla; it is fitted where it is not given.

    Returns
    -------
    Track
        The dipole of all samples, and that of each.

    Raises
    ------
    InputError
        When a shape is wrong or values are not finite.
    Refused
        When the readings do not determine the dipole.
    """
    fit = fit_dipole(fields_T, array, poses, uniform_field_T=regional_T, fit_uniform_field=regional_T is None)
    regional = np.asarray(fit.uniform_field_T if regional_T is None else regional_T, dtype=float)
    own = without_regional(fields_T, poses.attitude, regional)
    samples = locate_dipole(own.reshape(len(own), -1) @ array.operator.T, array, _covariance(array, regional, poses))
    return Track(fit, regional, samples, poses.place_in_world(samples.position_m))


def _covariance(array: Array, regional_T: FloatArray, poses: Poses) -> FloatArray | None:
    """Return the covariance (9, 9) of field and gradient.

    It is of the sensors' noise and of what an error of the attitude leaves of the regional field, the mean of its axes.
    """
    if array.vector_noise_T is None:
        return None
    covariance: FloatArray = array.operator * np.repeat(array.vector_noise_T**2, 3) @ array.operator.T
    covariance[:3, :3] += np.eye(3) * (2 / 3) * (poses.attitude_noise * norm(regional_T)) ** 2
    return covariance


def locate_steady(
    recording: Recording,
    calibration: Calibration,
    *,
    index: float = DIPOLE_INDEX,
    regional_T: FloatArray | None = None,
    attitude_noise: float = 0.0,
    velocity_m_per_s: FloatArray | None = None,
) -> Survey:
    """Locate a source at rest.

    Parameters
    ----------
    recording : Recording
        With attitude.
    calibration : Calibration
        Of its array.
    index : float
        Structural index.
    regional_T : (3,) array, optional
        Field beside the source's in the world, tesla; fitted where it is not given.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    velocity_m_per_s : (3,) array, optional
        Of a platform that goes straight, in the world; the dipole is then found from all samples together, in the
        world, and of each. Otherwise every sample stands by itself, and its position counts from the array.

    Raises
    ------
    InputError
        When there is no attitude, the calibration is of another array, or a track is asked for what is no dipole.
    Refused
        When no sample can be located, or the readings do not determine the dipole of the track.
    """
    if recording.attitude is None:
        raise InputError(
            "the recording has no attitude, without which the regional field cannot be taken off; of an alternating "
            "source give the frequency"
        )
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    if velocity_m_per_s is None:
        return _sample_by_sample(recording, calibration, index, regional_T, attitude_noise)
    if index != DIPOLE_INDEX:
        raise InputError(f"along a track a dipole is located: its structural index is 3, not {index:g}")
    return _along_track(recording, calibration, regional_T, attitude_noise, velocity_m_per_s)


def _sample_by_sample(
    recording: Recording,
    calibration: Calibration,
    index: float,
    regional_T: FloatArray | None,
    attitude_noise: float,
) -> Survey:
    assert recording.attitude is not None
    outputs = calibration.correct(recording).outputs
    regional = regional_of(outputs, recording.attitude) if regional_T is None else regional_T
    solutions = locate_samples(
        outputs,
        calibration.array,
        calibration.output_covariance,
        index=index,
        regional=Regional(regional, attitude_noise),
        attitude=recording.attitude,
    )
    center = np.zeros((recording.sample_count, 3))
    world = turned(solutions, recording.attitude)
    return Survey(WORLD_FRAME, recording.time_s, world, center, regional_T=regional)


def _along_track(
    recording: Recording,
    calibration: Calibration,
    regional_T: FloatArray | None,
    attitude_noise: float,
    velocity_m_per_s: FloatArray,
) -> Survey:
    recording = calibration.without_effects(recording)
    center = straight_track(recording.time_s, np.zeros(3), velocity_m_per_s)
    assert recording.attitude is not None
    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    recording, center = recording.take(known), center[known]
    assert recording.attitude is not None
    fields = calibration.errors.restore(recording.readings_T)
    poses = Poses(recording.attitude, center, attitude_noise)
    track = track_dipole(fields, calibration.array, poses, regional_T)
    fit = track.fit
    overall = Overall(
        fit.source.position_m,
        fit.covariance[:3, :3],
        fit.source.moment_Am2,
        fit.covariance[3:6, 3:6],
        fit.chi_square,
        fit.degrees_of_freedom,
    )
    world = replace(turned(track.samples, recording.attitude), position_m=track.sample_position_m)
    return Survey(TRACK_FRAME, recording.time_s, world, center, overall, track.regional_T)
