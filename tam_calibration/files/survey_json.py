"""A survey as JSON, SI with the unit in the key."""

from typing import Any

from tam_calibration.localization.solutions import Status
from tam_calibration.survey.result import Overall, Survey, standard_errors

SCHEMA = "tam_calibration/source/1"


def survey_to_mapping(survey: Survey) -> dict[str, Any]:
    """Return what `tam locate --json` prints; NaN where a value is not known."""
    line = survey.line
    return {
        "schema": SCHEMA,
        "frame": survey.frame,
        "frequency_Hz": line and line.frequency_hz,
        "frequency_standard_error_Hz": line and line.standard_error_hz,
        "regional_field_T": None if survey.regional_T is None else survey.regional_T.tolist(),
        "located": int(survey.solutions.is_located.sum()),
        "refused": {status.name.lower(): count for status, count in survey.refusals.items()},
        "overall": survey.overall and _overall(survey.overall),
        "samples": [_sample(survey, index) for index in range(len(survey.time_s))],
    }


def _overall(overall: Overall) -> dict[str, Any]:
    return {
        "position_m": overall.position_m.tolist(),
        "position_standard_errors_m": standard_errors(overall.position_covariance_m2).tolist(),
        "position_covariance_m2": overall.position_covariance_m2.tolist(),
        "moment_Am2": overall.moment_Am2.tolist(),
        "moment_standard_errors_Am2": standard_errors(overall.moment_covariance_A2m4).tolist(),
        "moment_covariance_A2m4": overall.moment_covariance_A2m4.tolist(),
        "chi_square": overall.chi_square,
        "degrees_of_freedom": overall.degrees_of_freedom,
    }


def _sample(survey: Survey, index: int) -> dict[str, Any]:
    solutions = survey.solutions
    sample = {
        "time_s": float(survey.time_s[index]),
        "status": Status(int(solutions.status[index])).name.lower(),
    }
    if not solutions.is_located[index]:
        return sample
    return sample | {
        "position_m": solutions.position_m[index].tolist(),
        "position_standard_errors_m": survey.position_standard_errors_m[index].tolist(),
        "position_covariance_m2": solutions.position_covariance_m2[index].tolist(),
        "moment_Am2": solutions.moment_Am2[index].tolist(),
        "moment_standard_errors_Am2": survey.moment_standard_errors_Am2[index].tolist(),
        "moment_covariance_A2m4": solutions.moment_covariance_A2m4[index].tolist(),
        "array_center_m": survey.center_m[index].tolist(),
    }
