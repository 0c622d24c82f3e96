"""HTML reports for people, and the figures that they share."""

from tam_calibration.report.calibration_report import write_calibration_report
from tam_calibration.report.coverage_map import plot_coverage
from tam_calibration.report.page import Section, embed, render
from tam_calibration.report.residual_plots import Panel, plot_histograms, plot_over_time

__all__ = [
    "Panel",
    "Section",
    "embed",
    "plot_coverage",
    "plot_histograms",
    "plot_over_time",
    "render",
    "write_calibration_report",
]
