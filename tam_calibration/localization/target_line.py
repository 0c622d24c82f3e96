"""The targets of a line: one or two dipoles beside an exactly straight track, or all targets along any path."""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.steady import DEFAULT_VELOCITY_ERROR, locate_steady
from tam_calibration.localization.survey import Survey, standard_errors
from tam_calibration.localization.targets import Target, find_targets, path_in
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.limits import SPEED
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_FEW = 2
"""Targets up to which a straight track is tried: beside it they are found as exactly as they can be."""

_AGREEING = 5.0
"""Standard errors within which both answers agree, so that the track may be straight."""


def locate_line(
    recording: Recording,
    calibration: Calibration,
    attitude_noise: float,
    velocity_m_per_s: FloatArray | None,
    velocity_error_m_per_s: float | None,
    position_error_m: float | None,
    position_drift_m: float,
) -> Survey | list[Target]:
    """Return the targets of a line, or the survey of a straight track that explains the readings as well.

    Parameters
    ----------
    recording : Recording
        With attitude, and with positions unless there is a velocity.
    calibration : Calibration
        Of its array.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    velocity_m_per_s : (3,) array, optional
        Of a platform that goes straight, instead of its positions.
    velocity_error_m_per_s : float, optional
        Standard deviation of each of its components; a tenth of the speed where it is not given, and where it is zero
        the track is exactly straight.
    position_error_m : float, optional
        Least standard deviation of the white error of positions, metres.
    position_drift_m : float
        Standard deviation of their slow error over the line, metres.

    Raises
    ------
    Refused
        When neither has an answer.
    """
    if velocity_m_per_s is None:
        path = path_in(recording, None, 0.0, position_error_m, position_drift_m)
        return find_targets(recording, calibration, path, attitude_noise)

    def straight() -> Survey:
        return locate_steady(
            recording,
            calibration,
            attitude_noise=attitude_noise,
            velocity_m_per_s=velocity_m_per_s,
            velocity_error_m_per_s=velocity_error_m_per_s,
        )

    if velocity_error_m_per_s == 0.0:
        return straight()
    SPEED.require("the velocity", velocity_m_per_s)
    error = (
        DEFAULT_VELOCITY_ERROR * norm(velocity_m_per_s) if velocity_error_m_per_s is None else velocity_error_m_per_s
    )
    SPEED.require("the error of the velocity", float(error))
    path = path_in(replace(recording, position_m=None), velocity_m_per_s, float(error))
    targets = find_targets(recording, calibration, path, attitude_noise)
    if len(targets) > _FEW:
        return targets
    try:
        survey = straight()
    except Refused:
        if targets:
            return targets
        raise
    return survey if not targets or _agrees(survey, targets) else targets


def _agrees(survey: Survey, targets: list[Target]) -> bool:
    """Return whether each source of a straight track is a target, within the standard errors of both."""
    if survey.overall is None:
        return False
    for source in (survey.overall, *survey.further):
        own = standard_errors(source.position_covariance_m2)
        away = [np.abs(each.position_m - source.position_m) / np.hypot(own, each.standard_errors_m) for each in targets]
        if min(float(each.max()) for each in away) > _AGREEING:
            return False
    return True
