"""Where the calibration comes from."""

from tam_calibration import __version__
from tam_calibration.calibration import Calibration
from tam_calibration.report.evidence import Evidence
from tam_calibration.report.formatting import count, fixed, number
from tam_calibration.report.page import Section, Table
from tam_calibration.units import to_nanotesla


def build(evidence: Evidence) -> Section:
    """Return the section."""
    calibration = evidence.calibration
    first, last = calibration.time_span_s
    rows = [
        *_source(calibration),
        ["samples", count(calibration.samples)],
        ["time", f"{fixed(first, 3)} s to {fixed(last, 3)} s, a span of {number(last - first, 4)} s"],
        ["mean intensity", f"{fixed(to_nanotesla(calibration.intensity_T), 1)} nT"],
        ["reference", "scalar magnetometer" if calibration.has_scalar_reference else "none"],
        ["method", calibration.method],
        ["software", f"tam_calibration {__version__}"],
    ]
    return Section("Provenance", [Table([], rows, numeric=False), _positions(calibration)])


def _source(calibration: Calibration) -> list[list[str]]:
    if calibration.source is None:
        return [["recording", "not from a file"]]
    source = calibration.source
    return [["recording", source.name], ["size", f"{count(source.size_bytes)} bytes"], ["SHA-256", source.sha256]]


def _positions(calibration: Calibration) -> Table:
    rows = [
        [str(i + 1), *(fixed(float(value), 4) for value in place)]
        for i, place in enumerate(calibration.array.positions_m)
    ]
    return Table(
        ["sensor", "x (m)", "y (m)", "z (m)"], rows, "Array: positions of the sensors, x forward, y left, z up."
    )
