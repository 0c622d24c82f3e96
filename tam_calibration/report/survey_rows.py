"""A survey, and the targets of survey lines, as rows of text, for the page and for the terminal."""

from collections.abc import Sequence

import numpy as np

from tam_calibration.localization.solutions import Overall, Survey, standard_errors
from tam_calibration.localization.targets import Target
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report.blocks import Block, Table
from tam_calibration.report.formatting import count, counted, number, with_error, with_errors

MOST_ROWS = 20
"""Samples that are shown; of more, some from the first to the last."""


def survey_answer(survey: Survey) -> str:
    """Return where the source is and how strong, in one line."""
    located, total = int(survey.solutions.is_located.sum()), len(survey.time_s)
    some = f"located in {count(located)} of {count(total)} samples by themselves"
    if survey.overall is None:
        distance = np.linalg.norm(survey.solutions.position_m - survey.center_m, axis=1)[survey.solutions.is_located]
        return f"A source is {some}, at {number(float(distance.min()))} to {number(float(distance.max()))} m."
    ((_, x, y, z, _), (*_, size)) = _overall_rows(survey.overall)
    return f"A source is at x {x}, y {y}, z {z} m, moment {size} A m²."


def source_blocks(survey: Survey) -> list[Block]:
    """Return where the source of all samples is; empty where there is none."""
    if survey.overall is None:
        return []
    caption = "The source of all samples together ± standard errors."
    return [Table(("", "x", "y", "z", "size"), _overall_rows(survey.overall), caption)]


def sample_blocks(survey: Survey, most: int = MOST_ROWS) -> list[Block]:
    """Return where single samples see the source, of many some from first to last; empty where none does."""
    located = np.flatnonzero(survey.solutions.is_located)
    shown = located[np.unique(np.linspace(0, len(located) - 1, min(len(located), most)).round().astype(int))]
    distance = np.linalg.norm(survey.solutions.position_m - survey.center_m, axis=1)
    moments, spreads = survey.solutions.moment_Am2, survey.solutions.moment_covariance_A2m4
    rows = [
        [
            number(float(survey.time_s[index] - survey.time_s[0]), 4),
            *with_errors(survey.solutions.position_m[index], survey.position_standard_errors_m[index], 3),
            number(float(distance[index])),
            _size(moments[index], spreads[index]),
        ]
        for index in shown
    ]
    header = ("time (s)", "x (m)", "y (m)", "z (m)", "distance (m)", "moment (A m²)")
    caption = "Position ± standard error of samples by themselves; of many some from first to last."
    return [Table(header, rows, caption)] if rows else []


def _overall_rows(overall: Overall) -> list[list[str]]:
    """Return rows of position, moment and fit of the source of all samples."""
    position = with_errors(overall.position_m, standard_errors(overall.position_covariance_m2), 3)
    moment = with_errors(overall.moment_Am2, standard_errors(overall.moment_covariance_A2m4), 3)
    size = _size(overall.moment_Am2, overall.moment_covariance_A2m4)
    return [
        ["position (m)", *position, number(float(np.linalg.norm(overall.position_m)))],
        ["moment (A m²)", *moment, size],
    ]


def statements(survey: Survey) -> list[str]:
    """Return statements on all of it, one sentence each."""
    words = [f"{survey.frame[:1].upper()}{survey.frame[1:]}."]
    if survey.line is not None:
        error = survey.line.standard_error_hz
        stated = "as stated" if np.isnan(error) else "found"
        hertz = survey.line.frequency_hz
        told = number(hertz, 6) if np.isnan(error) else with_error(hertz, error, 4)
        words.append(f"Frequency: {told} Hz, {stated}; amplitudes are peak values.")
    if survey.regional_T is not None:
        field = ", ".join(number(float(value), 6) for value in to_nanotesla(survey.regional_T))
        words.append(f"Regional field taken off, in the world: {field} nT.")
    if survey.overall is not None and np.isfinite(survey.overall.chi_square):
        reduced = survey.overall.chi_square / survey.overall.degrees_of_freedom
        words.append(f"Reduced χ² of all together: {number(reduced)}; near 1 where one dipole explains the readings.")
    words += [survey.note] * bool(survey.note)
    located, total = int(survey.solutions.is_located.sum()), len(survey.time_s)
    words.append(f"{count(located)} of {count(total)} located.")
    words += [f"{count(times)} refused: {status.reason}." for status, times in survey.refusals.most_common()]
    return words


def _size(vector: FloatArray, covariance: FloatArray) -> str:
    size = float(np.linalg.norm(vector))
    return with_error(size, float(np.sqrt(vector @ covariance @ vector)) / size, 3)


def targets_answer(targets: Sequence[Target]) -> str:
    """Return what a line shows, in one line."""
    if not targets:
        return "No target is seen along the line."
    extended = sum(each.is_extended for each in targets)
    of_them = f", {count(extended)} of them extended or too near for a dipole" if extended else ""
    return f"{counted(len(targets), 'target')} along the line{of_them}."


def target_table(targets: Sequence[Target]) -> Table:
    """Return a table with a row for each target: place and moment ± standard errors, distance, and what it is."""
    header = ("x (m)", "y (m)", "z (m)", "moment (A m²)", "distance (m)", "lines", "")
    rows = []
    for each in targets:
        places = with_errors(each.position_m, standard_errors(each.position_covariance_m2), 3)
        size = _size(each.moment_Am2, each.moment_covariance_A2m4)
        what = "dipole"
        if each.is_extended:
            what = f"extended over {number(each.extent_m, 2)} m" if each.extent_m else "extended or too near"
        rows.append([*places, size, number(each.distance_m), count(each.lines), what])
    return Table(header, rows, "Places in the world of the attitude ± standard errors.")
