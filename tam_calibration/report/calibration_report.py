"""The report on a calibration: one HTML page for the people who will rely on it."""

from pathlib import Path

from tam_calibration.calibration import Calibration
from tam_calibration.files import write_whole
from tam_calibration.recording import Recording
from tam_calibration.report.evidence import gather
from tam_calibration.report.formatting import count
from tam_calibration.report.page import render
from tam_calibration.report.sections import SECTIONS


def write_calibration_report(path: Path, calibration: Calibration, recording: Recording) -> None:
    """Write a self-contained HTML page about a calibration and the recording that it came from.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    calibration : Calibration
        The estimate.
    recording : Recording
        The raw recording that it was made from.

    Raises
    ------
    InputError
        When the recording is not of the calibration's array, or the file cannot be written.
    """
    evidence = gather(calibration, recording)
    sections = [section for build in SECTIONS if (section := build(evidence)) is not None]
    page = render("Calibration report", _subtitle(calibration), sections)
    with write_whole(path) as part:
        part.write_text(page, encoding="utf-8")


def _subtitle(calibration: Calibration) -> str:
    sensors = "1 sensor" if calibration.errors.sensor_count == 1 else f"{calibration.errors.sensor_count} sensors"
    source = f"{calibration.source.name}, " if calibration.source else ""
    return f"{source}{sensors}, {count(calibration.samples)} samples"
