"""The targets of a survey line as rows of text."""

from collections.abc import Sequence

import numpy as np
from numpy.linalg import norm

from tam_calibration.localization.survey import standard_errors
from tam_calibration.localization.target import Target
from tam_calibration.report.blocks import Table
from tam_calibration.report.formatting import count, number, with_error


def answer(targets: Sequence[Target]) -> str:
    """Return what a line shows, in one line."""
    if not targets:
        return "No target is seen along the line."
    extended = sum(each.is_extended for each in targets)
    of_them = f", {count(extended)} of them extended or too near for a dipole" if extended else ""
    ending = "" if len(targets) == 1 else "s"
    return f"{count(len(targets))} target{ending} along the line{of_them}."


def target_table(targets: Sequence[Target]) -> Table:
    """Return a table with a row for each target: place and moment ± standard errors, distance, and what it is."""
    header = ("x (m)", "y (m)", "z (m)", "moment (A m²)", "distance (m)", "lines", "")
    return Table(header, [_row(each) for each in targets], "Places in the world of the attitude ± standard errors.")


def _row(target: Target) -> list[str]:
    size = float(norm(target.moment_Am2))
    error = float(np.sqrt(target.moment_Am2 @ target.moment_covariance_A2m4 @ target.moment_Am2)) / size
    errors = standard_errors(target.position_covariance_m2)
    places = [with_error(float(value), float(own), 3) for value, own in zip(target.position_m, errors, strict=True)]
    what = "dipole"
    if target.is_extended:
        what = f"extended over {number(target.extent_m, 2)} m" if target.extent_m else "extended or too near"
    return [*places, with_error(size, error, 3), number(target.distance_m), count(target.lines), what]
