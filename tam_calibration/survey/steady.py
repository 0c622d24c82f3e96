"""A steady source beside the regional field, from a platform whose attitude is known."""

from dataclasses import replace

import numpy as np

from tam_calibration.calibration import Calibration
from tam_calibration.exceptions import InputError
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.poses import Poses
from tam_calibration.localization.sample_by_sample import Regional, locate_samples, regional_of, turned
from tam_calibration.localization.tracking import straight_track, track_dipole
from tam_calibration.recording import Recording
from tam_calibration.survey.result import TRACK_FRAME, WORLD_FRAME, Overall, Survey
from tam_calibration.units import FloatArray


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
