"""The page of survey lines: a map with the targets and their error ellipses, and what each line shows along its way."""

from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tam_calibration.localization.target import Target
from tam_calibration.localization.targets import SurveyLine
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report.blocks import Section, Text
from tam_calibration.report.page import embed, write_page
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.report.survey_report import error_ellipse
from tam_calibration.report.target_rows import answer, target_table

_MAP = "Lines and targets in plan, with ellipses that hold 95 %; an extended target is drawn as a square."
_COURSE = (
    "Along the line: intensity less its median, the square root of the gradient tensor's contraction, and "
    "the root mean square of the residuals over the noise, which is near 1 where the targets explain the readings. "
    "Dotted: targets."
)


@matplotlib.rc_context(STYLE)
def plot_map(lines: Sequence[SurveyLine], targets: Sequence[Target]) -> Figure:
    """Draw lines and targets in plan, east and north."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 3.6), layout="constrained")
    axes = figure.subplots()
    for line in lines:
        axes.plot(*line.center_m[:, :2].T, color=FLOOR_COLOR, linewidth=1.0)
    for number, target in enumerate(targets, 1):
        place = float(target.position_m[0]), float(target.position_m[1])
        axes.plot(*place, "s" if target.is_extended else "x", color=BEFORE_COLOR, fillstyle="none")
        axes.annotate(str(number), place, xytext=(4, 4), textcoords="offset points", fontsize=8)
        axes.add_patch(error_ellipse(target.position_m[:2], target.position_covariance_m2[:2, :2], BEFORE_COLOR, 1.2))
    axes.set(xlabel="x, east (m)", ylabel="y, north (m)", aspect="equal")
    axes.set_adjustable("datalim")
    return figure


@matplotlib.rc_context(STYLE)
def plot_course(line: SurveyLine) -> Figure:
    """Draw the anomaly, the invariant of the gradient and what is left along a line."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 4.6), layout="constrained")
    panels: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    courses = (
        (to_nanotesla(line.intensity_T - np.median(line.intensity_T)), "intensity (nT)", "linear"),
        (to_nanotesla(line.contraction_T_per_m), "gradient (nT/m)", "log"),
        (line.left, "residual / noise", "linear"),
    )
    passed = [line.along_m[np.argmin(np.linalg.norm(line.center_m - each.position_m, axis=1))] for each in line.targets]
    for axes, (values, label, scale) in zip(panels, courses, strict=True):
        axes.plot(line.along_m, values, color=AFTER_COLOR, linewidth=0.8)
        axes.set(ylabel=label, yscale=scale)
        for way in passed:
            axes.axvline(way, color=BEFORE_COLOR, linestyle=":", linewidth=0.8)
    panels[-1].set_xlabel("way along the line (m)")
    return figure


def write_targets_report(
    path: Path, lines: Sequence[SurveyLine], targets: Sequence[Target], names: Sequence[str]
) -> None:
    """Write a self-contained HTML page on survey lines.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails.
    lines : sequence of SurveyLine
        The lines.
    targets : sequence of Target
        Of all lines together.
    names : sequence of str
        Of the recordings, in the order of the lines.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    blocks = [target_table(targets)] if targets else []
    picture = embed(plot_map(lines, targets), "Map of the lines and their targets", _MAP)
    sections = [Section("Targets", [*blocks, picture])]
    for line, name in zip(lines, names, strict=True):
        notes = [Text(f"{line.note[0].upper()}{line.note[1:]}.")] if line.note else []
        course = embed(plot_course(line), f"Course along the line {name}", _COURSE)
        sections.append(Section(name, [*notes, course]))
    write_page(path, "Survey lines", answer(targets), sections)
