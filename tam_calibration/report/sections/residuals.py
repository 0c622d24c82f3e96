"""Residuals over time, before and after calibration."""

from collections.abc import Callable

from tam_calibration.report.evidence import NO_GRADIENT, Evidence
from tam_calibration.report.page import Block, Gallery, Section, Text, embed
from tam_calibration.report.panels import intensity_panels, tensor_panels
from tam_calibration.report.residual_plots import Panel, plot_over_time, thinning_note
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR
from tam_calibration.residuals import Residuals, ResidualSeries


def build(evidence: Evidence) -> Section:
    """Return the section."""
    blocks: list[Block] = [Text(_introduce(evidence))]
    blocks.append(_compare(evidence, intensity_panels, "nT", f"|B| − {evidence.reference_name}"))
    if evidence.calibration.array.has_gradient:
        blocks.append(_compare(evidence, tensor_panels, "nT/m", "Tensor components"))
    else:
        blocks.append(Text(NO_GRADIENT))
    return Section("Residuals over time", blocks)


def _introduce(evidence: Evidence) -> str:
    tensor = ", and the gradient tensor is zero" if evidence.calibration.array.has_gradient else ""
    return (
        f"In a uniform field the length |B| of every corrected vector equals {evidence.reference_name}{tensor}; "
        "what is left is the residual. The dashed lines are ± one standard deviation of the noise floor, which no "
        "calibration can remove. Before and after are drawn to their own scales. "
        f"{thinning_note(evidence.recording.sample_count)}"
    ).strip()


def _compare(
    evidence: Evidence, panels: Callable[[ResidualSeries, Residuals], list[Panel]], unit: str, what: str
) -> Gallery:
    pictures = []
    for state, color, series in (("before", BEFORE_COLOR, evidence.before), ("after", AFTER_COLOR, evidence.after)):
        figure = plot_over_time(evidence.recording.time_s, panels(series, evidence.calibration.floor), unit, color)
        title = f"{what}, {state} calibration"
        pictures.append(embed(figure, f"{title}, over time", title))
    return Gallery(pictures)
