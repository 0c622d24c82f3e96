"""Coverage of the sphere of field directions."""

import numpy as np

from tam_calibration.fit.coverage import Coverage
from tam_calibration.fit.weakness import find_weakness
from tam_calibration.report.coverage_map import plot_coverage
from tam_calibration.report.evidence import Evidence
from tam_calibration.report.formatting import number, sentence
from tam_calibration.report.page import Section, Text, embed


def build(evidence: Evidence) -> Section:
    """Return the section."""
    picture = embed(
        plot_coverage(evidence.coverage),
        "Map of the directions of the field",
        "Direction of the field in the array frame, equal-area (Hammer) map: forward is +x, left +y, up +z.",
    )
    weakness = find_weakness(evidence.recording, evidence.calibration)
    doubts = [Text(str(weakness))] if weakness.parameters else []
    return Section("Coverage of the sphere", [Text(_summary(evidence.coverage)), *doubts, picture])


def _summary(coverage: Coverage) -> str:
    seen = (
        f"The field visited {np.count_nonzero(coverage.counts)} of {len(coverage.counts)} cells of equal area "
        f"({100 * coverage.fraction:.0f} %)."
    )
    strength = "These directions do not determine every parameter."
    if np.isfinite(coverage.relative_error):
        size = number(coverage.relative_error)
        strength = f"The worst standard error is {size} × that of as many samples over the whole sphere."
    return f"{seen} {strength} {'' if coverage.enough else sentence(coverage.advice)}".strip()
