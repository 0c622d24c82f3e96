"""What recorded attitude would add to a calibration that was made without it."""

from dataclasses import replace

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.agreement import SEEN, MotionFit
from tam_calibration.fit.attitude_convention import misread_attitude
from tam_calibration.fit.attitude_likelihood import AttitudeLikelihood, WorldView
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.fit.recorded_attitude import strayed
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import PARAMETER_NAMES
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla

USE_IT = (
    "set attitude_noise_deg: estimate in the array file if the recorded attitude comes from gyroscope and "
    "accelerometer only"
)

_MOST_SAMPLES = 1000
"""By which the worth of attitude is judged."""

_WORTHLESS = 0.95
"""Ratio of standard errors with attitude to those without, above which it is not worth its risk."""

_UNITS = (("", 1.0), ("°", to_degrees(1.0)), (" nT", to_nanotesla(1.0)), ("°", to_degrees(1.0)))
"""Of scale factor, non-orthogonality, bias and misalignment in a sentence, and of one SI unit in it."""


def worth_of(recording: SampleSource, calibration: Calibration) -> str:
    """Return what recorded attitude would add to a calibration that was made without it; nothing where there is none.

    The information of its directions, with the scatter that they have about the corrected field, is added to that of
    the calibration: no fit is needed.

    Parameters
    ----------
    recording : SampleSource
        Raw readings that the calibration was made from.
    calibration : Calibration
        With a covariance.
    """
    some = recording.thinned(_MOST_SAMPLES)
    if some.attitude is None or not np.isfinite(some.attitude).all(axis=1).any() or calibration.covariance is None:
        return ""
    array = replace(calibration.array, attitude_noise=ATTITUDE_NOISE.most)
    problem = Problem.of(some, array, Known(start=calibration))
    assert isinstance(problem.motion, AttitudeLikelihood) and isinstance(problem.start.motion, WorldView)
    noise = problem.motion.scatter(*problem.rows_at(problem.start), problem.start.motion)
    if reason := strayed(noise):
        return misread_attitude(some, calibration.errors) or f"recorded attitude is not used: {reason}"
    used = MotionFit(replace(problem, motion=replace(problem.motion, attitude_noise=noise)), problem.start)
    information = used.own.information * recording.sample_count / some.sample_count
    words = f"recorded attitude (noise {to_degrees(noise):.2g}°) is not used: "
    if _ratio(calibration, information).min() < _WORTHLESS:
        information /= used.lasting()
    ratio = _ratio(calibration, information)
    if ratio.min() > _WORTHLESS:
        return f"{words}it would reduce no standard error by more than {1 - _WORTHLESS:.0%}"
    sensor, parameter = np.unravel_index(int(np.argmin(ratio)), ratio.shape)
    unit, factor = _UNITS[parameter // 3]
    before = factor * float(calibration.standard_errors[sensor, parameter])
    return (
        f"{words}it would reduce the standard error of {PARAMETER_NAMES[parameter]} of sensor {sensor + 1} from "
        f"{before:.2g} to {ratio.min() * before:.2g}{unit}; {USE_IT}"
    )


def _ratio(calibration: Calibration, information: FloatArray) -> FloatArray:
    """Return the (K, 12) standard errors with more information over those without; its last unknowns are the view."""
    assert calibration.covariance is not None
    size, before = len(calibration.covariance), calibration.standard_errors
    cross, view = information[:size, -5:], information[-5:, -5:] + np.eye(5)
    information = information[:size, :size] - cross @ np.linalg.solve(view, cross.T)
    root = calibration.covariance @ whitening(calibration.covariance, SEEN)
    after = root @ np.linalg.solve(np.eye(root.shape[1]) + root.T @ information @ root, root.T)
    errors = np.sqrt(np.diag(after)).reshape(before.shape)
    return np.asarray(np.divide(errors, before, out=np.ones_like(before), where=before > 0))
