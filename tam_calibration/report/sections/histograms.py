"""Distributions of the residuals against the noise floor."""

from collections.abc import Sequence

from tam_calibration.report.evidence import Evidence
from tam_calibration.report.page import Gallery, Image, Section, Text, embed
from tam_calibration.report.panels import intensity_panels, tensor_panels
from tam_calibration.report.residual_plots import Panel, plot_histograms

_INTRO = (
    "Residuals after calibration (blue) against the Gaussian of the noise floor (line), with their RMS over the floor. "
    "A histogram that is wider than its line, shifted or lopsided holds more than sensor noise. "
    "“Outside” counts samples beyond the axis."
)


def build(evidence: Evidence) -> Section:
    """Return the section."""
    floor = evidence.calibration.floor
    pictures = [_histograms(intensity_panels(evidence.after, floor), "nT", f"|B| − {evidence.reference_name}")]
    if evidence.calibration.array.has_gradient:
        pictures.append(_histograms(tensor_panels(evidence.after, floor), "nT/m", "Tensor components"))
    return Section("Distribution of the residuals", [Text(_INTRO), Gallery(pictures)])


def _histograms(panels: Sequence[Panel], unit: str, what: str) -> Image:
    return embed(plot_histograms(panels, unit), f"Histograms: {what}, after calibration", f"{what}, after calibration")
