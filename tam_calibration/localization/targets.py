"""The targets that a survey line shows: dipoles, and bodies that are too large or too near to be dipoles."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.attitude_convention import misread_attitude
from tam_calibration.localization.calibration_errors import errors_of
from tam_calibration.localization.line_data import line_data
from tam_calibration.localization.line_path import Path, path_of, reckoned
from tam_calibration.localization.survey import standard_errors
from tam_calibration.localization.target_search import LEAST_GAIN, Found, search
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

WITHIN_BODY, NEAR_BODY = 0.75, 1.0
"""Distance between dipoles, over that from the path, below which three or more are parts of one body, and below which
an uncertain one is a part of the body beside it: a body as large as its distance shows as dipoles so far apart."""

LARGEST_MISFIT = 10.0
"""Mean squared residual, over the noise, above which a target that no further dipole explains is no dipole: a path that
sways faster than its knots leaves some times the noise, by which standard errors are widened."""

_LARGEST_ERROR = 0.3
"""Standard error of a place, over its distance, beyond which first order says nothing."""

_WAY_S = 5.0
"""Time over which the way along a line is measured straight, seconds."""


@dataclass(frozen=True, eq=False)
class Target:
    """A target.

    Parameters
    ----------
    position_m : (3,) array
        In the world of the attitude, metres.
    position_covariance_m2 : (3, 3) array
        Of that, widened by residuals beyond the noise, and by the extent of an extended body.
    moment_Am2 : (3,) array
        Magnetic moment, of an extended body that of all its parts, A m².
    moment_covariance_A2m4 : (3, 3) array
        Of that.
    evidence : float
        By how much χ² would rise without it, over the misfit.
    distance_m : float
        Least distance from the path, metres.
    extent_m : float
        Of an extended body: largest distance between its parts, metres, zero where it shows as one; of a dipole zero.
    is_extended : bool
        Whether it is larger, or nearer, than a dipole.
    misfit : float
        Mean squared residual about it, over the noise.
    """

    position_m: FloatArray
    position_covariance_m2: FloatArray
    moment_Am2: FloatArray
    moment_covariance_A2m4: FloatArray
    evidence: float
    distance_m: float
    extent_m: float
    is_extended: bool
    misfit: float

    @property
    def standard_errors_m(self) -> FloatArray:
        """(3,) of the position, metres."""
        return standard_errors(self.position_covariance_m2)


def path_in(
    recording: Recording,
    velocity_m_per_s: FloatArray | None = None,
    velocity_error_m_per_s: float = 0.0,
    position_error_m: float | None = None,
    position_drift_m: float = 0.0,
) -> Path:
    """Return the path of a recording: its positions, or what a velocity makes.

    Parameters
    ----------
    recording : Recording
        With positions, unless a velocity is given.
    velocity_m_per_s : (3,) array, optional
        Of a platform that goes straight, in the world.
    velocity_error_m_per_s : float
        Standard deviation of each of its components.
    position_error_m : float, optional
        Least standard deviation of the white error of positions; they may show a larger one.
    position_drift_m : float
        Standard deviation of their slow error over the line.

    Raises
    ------
    InputError
        When there is neither position nor velocity.
    """
    if recording.position_m is not None:
        return path_of(recording.time_s, recording.position_m, position_error_m, position_drift_m)
    if velocity_m_per_s is None:
        raise InputError("the recording has no positions: add columns x_m, y_m, z_m, or state --velocity")
    return reckoned(recording.time_s, velocity_m_per_s, velocity_error_m_per_s)


def find_targets(
    recording: Recording, calibration: Calibration, path: Path, attitude_noise: float = 0.0
) -> list[Target]:
    """Return the targets that a platform passed, the strongest evidence first.

    Parameters
    ----------
    recording : Recording
        With attitude.
    calibration : Calibration
        Of its array.
    path : Path
        Of the array's centre.
    attitude_noise : float
        Least standard deviation of the attitude about each axis, radians; the readings may show a larger one.

    Raises
    ------
    InputError
        When there is no attitude.
    Refused
        When the attitude was written otherwise than expected, or the line is too short.
    """
    if misread := misread_attitude(recording, calibration.errors):
        raise Refused(misread)
    if recording.attitude is None:
        raise InputError("the recording has no attitude, without which readings cannot be turned into the world")
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    recording = calibration.without_effects(recording)
    assert recording.attitude is not None
    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    recording = recording.take(known)
    assert recording.attitude is not None
    fields = calibration.errors.restore(recording.readings_T)
    errors = errors_of(calibration, fields)
    way = _way_m(path, recording.time_s)
    data = line_data(recording.time_s, fields, recording.attitude, calibration.array, way, attitude_noise, errors)
    return _told(search(data, path))


def _way_m(path: Path, time_s: FloatArray) -> FloatArray:
    """Return the way (N,) along a path, without the sway of some seconds, metres."""
    count = max(2, int((time_s[-1] - time_s[0]) / _WAY_S) + 1)
    marks = np.linspace(time_s[0], time_s[-1], count)
    way = np.concatenate([[0.0], np.cumsum(norm(np.diff(path.at(marks), axis=0), axis=1))])
    return np.asarray(np.interp(time_s, marks, way))


def _told(found: list[Found]) -> list[Target]:
    """Return what dipoles are told as: those that are certain, and several within one body as one extended target."""
    targets = []
    for group in _bodies(found):
        misfit = max(max(each.misfit for each in group), 1.0)
        has_parts = len(group) > 2 or (len(group) > 1 and not all(map(_is_certain, group)))
        is_extended = has_parts or misfit > LARGEST_MISFIT
        told = [_of_body(group, misfit)] if is_extended else [_of_dipole(each) for each in group if _is_certain(each)]
        targets += [each for each in told if each.evidence > LEAST_GAIN]
    return sorted(targets, key=lambda each: -each.evidence)


def _is_certain(each: Found) -> bool:
    """Return whether a dipole is there, and its place known to a part of its distance."""
    factor = max(each.misfit, 1.0)
    error = float(np.sqrt(factor * np.diag(each.covariance)[:3].max()))
    return each.gain > LEAST_GAIN * factor and error < _LARGEST_ERROR * each.distance_m


def _bodies(found: list[Found]) -> list[list[Found]]:
    """Return groups of dipoles that are nearer to each other than bodies at their distance are large."""
    groups: list[list[Found]] = []
    for each in found:
        near = [group for group in groups if any(_are_one(each, other) for other in group)]
        groups = [group for group in groups if group not in near] + [[each, *(one for group in near for one in group)]]
    return groups


def _are_one(one: Found, other: Found) -> bool:
    apart = float(norm(one.unknowns[:3] - other.unknowns[:3]))
    reach = WITHIN_BODY if _is_certain(one) and _is_certain(other) else NEAR_BODY
    return apart < reach * max(one.distance_m, other.distance_m)


def _of_dipole(each: Found) -> Target:
    factor = max(each.misfit, 1.0)
    spread = factor * each.covariance
    return Target(
        each.unknowns[:3],
        spread[:3, :3],
        each.unknowns[3:],
        spread[3:, 3:],
        each.gain / factor,
        each.distance_m,
        0.0,
        False,
        each.misfit,
    )


def _of_body(group: list[Found], misfit: float) -> Target:
    """Return a body of several dipoles: their mean place by the size of their moments, and the sum of these."""
    rows = np.array([each.unknowns for each in group])
    weights = norm(rows[:, 3:], axis=1) / norm(rows[:, 3:], axis=1).sum()
    place = weights @ rows[:, :3]
    covariance = np.array([each.covariance for each in group])
    spread = misfit * np.einsum("s,sij->ij", weights**2, covariance[:, :3, :3])
    apart = rows[:, :3] - place
    extent = float(norm(rows[:, None, :3] - rows[:, :3], axis=2).max())
    distance = min(each.distance_m for each in group)
    own = extent if len(group) > 1 else 0.5 * distance
    spread = spread + np.einsum("s,si,sj->ij", weights, apart, apart) + (own / 4) ** 2 * np.eye(3)
    moments = misfit * covariance[:, 3:, 3:].sum(axis=0)
    evidence = max(each.gain for each in group) / misfit
    return Target(place, spread, rows[:, 3:].sum(axis=0), moments, evidence, distance, extent, True, misfit)
