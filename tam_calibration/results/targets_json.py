"""Sources and targets as the JSON of `tam locate`."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tam_calibration.localization.solutions import Status
from tam_calibration.localization.survey import WORLD_FRAME, Overall, Survey, standard_errors
from tam_calibration.localization.target import Target
from tam_calibration.model.units import FloatArray
from tam_calibration.results.results_json import attributes


def targets_to_mapping(targets: Sequence[Target]) -> dict[str, Any]:
    """Return what `tam locate --json` prints of a survey line, the target with the strongest evidence first."""
    return {
        "schema": "tam_calibration/targets/1",
        "frame": WORLD_FRAME.partition(",")[0],
        "targets": [_target(each) for each in targets],
    }


def _target(target: Target) -> dict[str, Any]:
    return {
        **attributes(target, "position_m"),
        "standard_error_m": target.standard_errors_m.tolist(),
        **attributes(target, "position_covariance_m2"),
        "moment_A_m2": target.moment_Am2.tolist(),
        "moment_standard_error_A_m2": standard_errors(target.moment_covariance_A2m4).tolist(),
        **attributes(target, "evidence", "distance_m"),
        "extended": target.is_extended,
        **attributes(target, "extent_m", "misfit"),
        "moment_along_field_A_m2": target.along_field_Am2,
        "iron_sphere_diameter_m": target.sphere_diameter_m,
        **attributes(target, "lines", "repeat_m"),
    }


def survey_to_mapping(survey: Survey) -> dict[str, Any]:
    """Return what `tam locate --json` prints; NaN where a value is not known."""
    line = survey.line
    return {
        "schema": "tam_calibration/source/1",
        "frame": survey.frame,
        "frequency_Hz": line and line.frequency_hz,
        "frequency_standard_error_Hz": line and line.standard_error_hz,
        "regional_field_T": None if survey.regional_T is None else survey.regional_T.tolist(),
        "located": int(survey.solutions.is_located.sum()),
        "refused": {status.name.lower(): count for status, count in survey.refusals.items()},
        "overall": survey.overall and _overall(survey.overall),
        "targets": [] if survey.overall is None else [_as_target(survey.overall)],
        "samples": [_sample(survey, index) for index in range(len(survey.time_s))],
    }


_ESTIMATE = "position_m", "position_covariance_m2", "moment_Am2", "moment_covariance_A2m4"


def _source(*estimate: FloatArray) -> dict[str, list[Any]]:
    """Return position (3,) and moment (3,) of a source, each with its standard errors and its covariance.

    Parameters
    ----------
    *estimate : array
        The four of ``_ESTIMATE``, SI.
    """
    position_m, position_covariance_m2, moment_Am2, moment_covariance_A2m4 = estimate
    return {
        "position_m": position_m.tolist(),
        "position_standard_errors_m": standard_errors(position_covariance_m2).tolist(),
        "position_covariance_m2": position_covariance_m2.tolist(),
        "moment_Am2": moment_Am2.tolist(),
        "moment_standard_errors_Am2": standard_errors(moment_covariance_A2m4).tolist(),
        "moment_covariance_A2m4": moment_covariance_A2m4.tolist(),
    }


def _overall(overall: Overall) -> dict[str, Any]:
    source = _source(*(getattr(overall, name) for name in _ESTIMATE))
    return {**source, **attributes(overall, "chi_square", "degrees_of_freedom")}


def _as_target(overall: Overall) -> dict[str, Any]:
    """Return a source in the form of a target; its evidence is the squared moment over its covariance."""
    moment = overall.moment_Am2
    return {
        "position_m": overall.position_m.tolist(),
        "standard_error_m": standard_errors(overall.position_covariance_m2).tolist(),
        "moment_A_m2": moment.tolist(),
        "evidence": float(moment @ np.linalg.solve(overall.moment_covariance_A2m4, moment)),
        "extended": False,
    }


def _sample(survey: Survey, index: int) -> dict[str, Any]:
    solutions = survey.solutions
    status = Status(int(solutions.status[index])).name.lower()
    sample = {"time_s": float(survey.time_s[index]), "status": status}
    if not solutions.is_located[index]:
        return sample
    source = _source(*(getattr(solutions, name)[index] for name in _ESTIMATE))
    return {**sample, **source, "array_center_m": survey.center_m[index].tolist()}
