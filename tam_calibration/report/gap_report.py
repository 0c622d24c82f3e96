"""The report on a gap: one HTML page for an engineer who never met the method."""

from pathlib import Path

from tam_calibration.calibration import Provenance
from tam_calibration.files import write_whole
from tam_calibration.gap.result import Gap
from tam_calibration.report.formatting import count
from tam_calibration.report.gap_sections import SECTIONS
from tam_calibration.report.gap_view import GapView
from tam_calibration.report.page import render


def write_gap_report(path: Path, gap: Gap, source: Provenance | None = None) -> None:
    """Write a self-contained HTML page about a gap.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    gap : Gap
        The diagnosis.
    source : Provenance, optional
        The recording that it is of.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    view = GapView(gap)
    sections = [section for build in SECTIONS for section in build(view)]
    page = render("The gap between recording and simulation", _subtitle(view, source), sections)
    with write_whole(path) as part:
        part.write_text(page, encoding="utf-8")


def _subtitle(view: GapView, source: Provenance | None) -> str:
    sensors = "1 sensor" if view.sensor_count == 1 else f"{view.sensor_count} sensors"
    name = f"{source.name}, " if source else ""
    digest = f", SHA-256 {source.sha256}" if source else ""
    return f"{name}{sensors}, {count(len(view.gap.residue.time_s))} samples{digest}"
