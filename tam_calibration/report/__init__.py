"""HTML reports for people, and the figures that they share."""

from tam_calibration.report.calibration_report import write_calibration_report

__all__ = ["write_calibration_report"]
