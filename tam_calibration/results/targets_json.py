"""Targets as the JSON of `tam locate`."""

from collections.abc import Sequence
from typing import Any

from tam_calibration.localization.survey import WORLD_FRAME, standard_errors
from tam_calibration.localization.target import Target


def targets_to_mapping(targets: Sequence[Target]) -> dict[str, Any]:
    """Return what `tam locate --json` prints of a survey line, the target with the strongest evidence first."""
    return {
        "schema": "tam_calibration/targets/1",
        "frame": WORLD_FRAME.partition(",")[0],
        "targets": [_target(each) for each in targets],
    }


def _target(target: Target) -> dict[str, Any]:
    return {
        "position_m": target.position_m.tolist(),
        "standard_error_m": target.standard_errors_m.tolist(),
        "position_covariance_m2": target.position_covariance_m2.tolist(),
        "moment_A_m2": target.moment_Am2.tolist(),
        "moment_standard_error_A_m2": standard_errors(target.moment_covariance_A2m4).tolist(),
        "evidence": target.evidence,
        "distance_m": target.distance_m,
        "extended": target.is_extended,
        "extent_m": target.extent_m,
        "misfit": target.misfit,
        "moment_along_field_A_m2": target.along_field_Am2,
        "iron_sphere_diameter_m": target.sphere_diameter_m,
        "lines": target.lines,
        "repeat_m": target.repeat_m,
    }
