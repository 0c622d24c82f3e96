"""The sections of a calibration report, one file each, in the order in which they are read."""

from collections.abc import Callable

from tam_calibration.report.evidence import Evidence
from tam_calibration.report.page import Section
from tam_calibration.report.sections import (
    coverage,
    histograms,
    known_source,
    parameters,
    provenance,
    quality,
    residuals,
    verdict,
)

SECTIONS: tuple[Callable[[Evidence], Section | None], ...] = (
    verdict.build,
    residuals.build,
    coverage.build,
    histograms.build,
    parameters.build,
    known_source.build,
    quality.build,
    provenance.build,
)
"""What makes each section from the evidence; None where it has nothing to tell."""
