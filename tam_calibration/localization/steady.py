"""A steady source beside the regional field: from all samples of a track together, or from each by itself."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.attitude_convention import misread_attitude
from tam_calibration.localization.calibration_errors import errors_of
from tam_calibration.localization.euler import DIPOLE_INDEX, require_index
from tam_calibration.localization.line_fit import DIPOLES_INDEX
from tam_calibration.localization.one_source import locate_run
from tam_calibration.localization.passage import (
    ERRORS,
    GRADIENT,
    OF_SOURCE,
    UNIFORM,
    VELOCITY,
    Known,
    Passage,
    passage_of,
)
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.survey import TRACK_FRAME, WORLD_FRAME, Overall, Survey, Track, standard_errors
from tam_calibration.localization.track_fit import TrackFit, fit_track
from tam_calibration.localization.turned_samples import SOURCES, Regional, locate_samples, regional_of, turned
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import SPEED
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import Dipole, dipole_field
from tam_calibration.sources.poses import Poses

DEFAULT_VELOCITY_ERROR = 0.1
"""Standard error of a velocity that none is stated of, as a part of the speed: dead reckoning in a current."""

_NO_ERROR_M_PER_S = 1e-9
"""Largest error of a velocity that counts as none, m/s: it makes 4 µm in an hour."""


@dataclass(frozen=True, eq=False)
class TrackedSources:
    """Dipoles that were passed.

    Parameters
    ----------
    fit : TrackFit
        Of the sources, the strongest signal first, the regional field and the velocity.
    samples : EulerSolutions
        The first source from each sample by itself, in the array frame.
    """

    fit: TrackFit
    samples: EulerSolutions

    @property
    def passage(self) -> Passage:
        """What was fitted."""
        return self.fit.passage

    @property
    def unknowns(self) -> FloatArray:
        """(P,) what was found."""
        return np.asarray(self.fit.solution.unknowns[0])

    @property
    def covariance(self) -> FloatArray:
        """(P, P) of it, widened by what the residuals are more than noise."""
        return np.asarray(self.fit.solution.covariance[0] * self.fit.misfit.variance_factor)

    @property
    def sources(self) -> list[tuple[Dipole, FloatArray]]:
        """The dipoles in the world, each with the covariance (6, 6) of place [m] and moment [A m²]."""
        rows = self.fit.sources
        parts = (slice(OF_SOURCE * number, OF_SOURCE * (number + 1)) for number in range(len(rows)))
        return [(Dipole(row[:3], row[3:]), self.covariance[part, part]) for row, part in zip(rows, parts, strict=True)]

    @property
    def further_covariance(self) -> FloatArray:
        """(11 + Q, 11 + Q) covariance of u, G, δv and z: zero of what is exact."""
        free = self.passage.known.is_free
        full, count = np.zeros((len(free), len(free))), int(free.sum())
        full[np.ix_(free, free)] = self.covariance[-count:, -count:] if count else 0.0
        return full


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


def track_dipole(
    fields_T: FloatArray,
    array: Array,
    poses: Poses,
    regional: Regional | None = None,
    *,
    time_s: FloatArray | None = None,
    velocity_error_m_per_s: float = 0.0,
    errors_T: FloatArray | None = None,
) -> TrackedSources:
    """Find the dipoles at rest from the samples of a platform that passes them.

    Beside them is a regional field with a constant gradient.

    Parameters
    ----------
    fields_T : (N, K, 3) array
        Calibrated readings, array frame, tesla.
    array : Array
        Positions and noise of the sensors.
    poses : Poses
        Attitude and position of the array at each sample, and the noise of the attitude: 0.1° in 50 µT are 87 nT in
        all sensors alike, which is then no signal.
    regional : Regional, optional
        What is known of the field of the world at the origin; nothing where it is not given.
    time_s : (N,) array, optional
        Times of the samples, seconds, where the velocity has an error.
    velocity_error_m_per_s : float
        Standard error of each component of the velocity by which positions were reckoned from the first on.
    errors_T : (N, 3 K, Q) array, optional
        What errors of the calibration add to the readings, tesla: see ``calibration_errors.errors_of``.

    Returns
    -------
    TrackedSources
        The dipoles of all samples, and the first of each.

    Raises
    ------
    InputError
        When a shape is wrong or values are not finite.
    Refused
        When the readings do not determine the dipoles, or are not those of dipoles.
    """
    expected, standard_error = np.zeros(11), np.full(11, np.inf)
    if regional is not None:
        expected[UNIFORM] = regional.field_T
        standard_error[UNIFORM] = 0.0
        if regional.covariance_T2 is not None:
            standard_error[UNIFORM] = standard_errors(regional.covariance_T2)
    standard_error[VELOCITY] = velocity_error_m_per_s if velocity_error_m_per_s > _NO_ERROR_M_PER_S else 0.0
    passage = passage_of(dipole_field, fields_T, array, poses, Known(expected, standard_error), time_s, errors_T)
    tracked = TrackedSources(fit_track(passage), EulerSolutions.refused(len(passage.matrix), Status.NO_REGIONAL))
    return replace(tracked, samples=_by_themselves(tracked, array, poses))


def _by_themselves(tracked: TrackedSources, array: Array, poses: Poses) -> EulerSolutions:
    """Return the first source from each sample, less all that was found beside it."""
    passage, unknowns = tracked.passage, tracked.unknowns.copy()
    field = passage.further(unknowns)[UNIFORM]
    spread = tracked.further_covariance
    unknowns[3:OF_SOURCE] = 0.0
    rest = passage.left_T(unknowns) + (np.swapaxes(passage.matrix, 1, 2) @ field)[:, None]
    by_field = np.hstack([np.eye(3), np.einsum("qij,j->iq", UNIT_TENSORS, tracked.sources[0][0].position_m)])
    covariance = by_field @ spread[:8, :8] @ by_field.T
    outputs = rest.reshape(len(rest), -1) @ array.operator.T
    noise = array.operator * np.repeat(passage.noise_T**2, 3) @ array.operator.T
    if passage.errors_T is not None:
        by_errors = array.operator @ passage.errors_T
        noise += np.mean(by_errors @ spread[ERRORS, ERRORS] @ np.swapaxes(by_errors, 1, 2), axis=0)
    return locate_samples(
        outputs,
        array,
        noise,
        regional=Regional(field, poses.attitude_noise, covariance),
        attitude=poses.attitude,
    )


def locate_steady(
    recording: Recording,
    calibration: Calibration,
    *,
    index: float = DIPOLE_INDEX,
    regional_T: FloatArray | None = None,
    regional_covariance_T2: FloatArray | None = None,
    attitude_noise: float = 0.0,
    velocity_m_per_s: FloatArray | None = None,
    velocity_error_m_per_s: float | None = None,
) -> Survey:
    """Locate a source at rest.

    Parameters
    ----------
    recording : Recording
        With attitude.
    calibration : Calibration
        Of its array.
    index : float
        Structural index: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current.
    regional_T : (3,) array, optional
        Field beside the source's in the world, tesla; fitted where it is not given.
    regional_covariance_T2 : (3, 3) array, optional
        Of that, T²; without it the field is exact.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    velocity_m_per_s : (3,) array, optional
        Of a platform that goes straight, in the world; dipoles are then found from all samples together, in the
        world, and the first of each. Otherwise every sample stands by itself, and its position counts from the array.
    velocity_error_m_per_s : float, optional
        Standard error of each of its components; a tenth of the speed where it is not given.

    Raises
    ------
    InputError
        When there is no attitude, the calibration is of another array, or a track is asked for what is no dipole.
    Refused
        When the attitude was written otherwise than expected, no sample can be located, the samples are not those of
        one source, or the readings do not determine the dipoles of the track or are none's.
    """
    require_index(index)
    if misread := misread_attitude(recording, calibration.errors):
        raise Refused(misread)
    if recording.attitude is None:
        raise InputError(
            "the recording has no attitude, without which the regional field cannot be taken off; of an alternating "
            "source give the frequency"
        )
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    regional = None if regional_T is None else Regional(regional_T, attitude_noise, regional_covariance_T2)
    if velocity_m_per_s is None:
        return _sample_by_sample(recording, calibration, index, regional, attitude_noise)
    if index != DIPOLE_INDEX:
        raise InputError(
            f"along a track a dipole is located: its structural index is 3, not {index:g}; leave out the velocity, and "
            "each sample is located by itself"
        )
    SPEED.require("the velocity", velocity_m_per_s)
    speed = float(norm(velocity_m_per_s))
    error = DEFAULT_VELOCITY_ERROR * speed if velocity_error_m_per_s is None else velocity_error_m_per_s
    SPEED.require("the error of the velocity", error)
    return _along_track(recording, calibration, regional, attitude_noise, velocity_m_per_s, error)


def _sample_by_sample(
    recording: Recording,
    calibration: Calibration,
    index: float,
    regional: Regional | None,
    attitude_noise: float,
) -> Survey:
    assert recording.attitude is not None
    outputs = calibration.correct(recording).outputs
    prior = _prior(outputs, recording.attitude, index, regional, attitude_noise)
    world, found = locate_run(
        outputs, calibration.array, calibration.output_covariance, recording.attitude, prior, index
    )
    center = np.zeros((recording.sample_count, 3))
    return Survey(WORLD_FRAME, recording.time_s, world, center, regional_T=found.field_T)


def _prior(
    outputs: FloatArray, attitude: FloatArray, index: float, known: Regional | None, attitude_noise: float
) -> Regional:
    """Return what is known beforehand of the field beside the source's."""
    if index != DIPOLE_INDEX and attitude_noise:
        raise Refused(
            f"a {SOURCES[index]} is located with an exact attitude alone: the regional field, turned by an "
            "error of it, hides what tells one line from several"
        )
    if index == DIPOLES_INDEX and known is None:
        raise Refused(
            f"beside a {SOURCES[index]} the regional field cannot be found from the samples: give the "
            "place, at which it is that of IGRF"
        )
    return regional_of(outputs, attitude, attitude_noise) if known is None else known


def _along_track(
    recording: Recording,
    calibration: Calibration,
    regional: Regional | None,
    attitude_noise: float,
    velocity_m_per_s: FloatArray,
    velocity_error_m_per_s: float,
) -> Survey:
    recording = calibration.without_effects(recording)
    path = straight_track(recording.time_s, np.zeros(3), velocity_m_per_s)
    assert recording.attitude is not None
    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    recording, path = recording.take(known), path[known]
    assert recording.attitude is not None
    fields = calibration.errors.restore(recording.readings_T)
    poses, since = Poses(recording.attitude, path, attitude_noise), recording.time_s - recording.time_s[0]
    tracked = track_dipole(
        fields,
        calibration.array,
        poses,
        regional,
        time_s=since,
        velocity_error_m_per_s=velocity_error_m_per_s,
        errors_T=errors_of(calibration, fields),
    )
    first, *others = [_overall(tracked, source, covariance) for source, covariance in tracked.sources]
    center = tracked.passage.center_m(tracked.unknowns)
    world = turned(tracked.samples, recording.attitude, attitude_noise)
    world = replace(world, position_m=world.position_m + center)
    further = tracked.passage.further(tracked.unknowns)
    track = _track(tracked, further, velocity_m_per_s)
    return Survey(
        TRACK_FRAME, recording.time_s, world, center, first, further[UNIFORM], further=tuple(others), track=track
    )


def _overall(tracked: TrackedSources, source: Dipole, covariance: FloatArray) -> Overall:
    solution, passage = tracked.fit.solution, tracked.passage
    freedom = passage.degrees_of_freedom - tracked.fit.sources.size
    chi_square = float(solution.chi_square[0])
    return Overall(source.position_m, covariance[:3, :3], source.moment_Am2, covariance[3:, 3:], chi_square, freedom)


def _track(tracked: TrackedSources, further: FloatArray, velocity_m_per_s: FloatArray) -> Track:
    spread = tracked.further_covariance
    variance = np.einsum("pij,pq,qij->ij", UNIT_TENSORS, spread[GRADIENT, GRADIENT], UNIT_TENSORS)
    return Track(
        standard_errors(spread[UNIFORM, UNIFORM]),
        np.tensordot(further[GRADIENT], UNIT_TENSORS, 1),
        np.sqrt(variance),
        np.asarray(velocity_m_per_s) + further[VELOCITY],
        standard_errors(spread[VELOCITY, VELOCITY]),
        tracked.fit.misfit.noise_variance,
        tracked.fit.misfit.colour,
    )
