"""`tam locate`: where the source in a recording is."""

from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Column, Table

from tam_calibration.cli.terminal import PATH, reading, showing_progress, stdout, tolerance_option, write_together
from tam_calibration.correction.calibration import Calibration
from tam_calibration.files import read_calibration, read_samples
from tam_calibration.files.text_files import to_json
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.steady import locate_steady
from tam_calibration.localization.survey import Survey
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2, field_at
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.report.survey_rows import HEADER, overall_rows, sample_rows, statements


def _print_survey(console: Console, survey: Survey) -> None:
    """Print the source of all samples, of each, and what holds for them."""
    if survey.overall is not None:
        for number, one in enumerate((survey.overall, *survey.further), 1):
            title = f"Source {number} ± standard errors" if survey.further else "The source ± standard errors"
            table = Table("", *_right("x", "y", "z", "size"), title=title)
            for row in overall_rows(one):
                table.add_row(*row)
            console.print(table)
    if rows := sample_rows(survey):
        table = Table(*_right(*HEADER), title="Poses" if survey.line else "Samples by themselves")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    for words in statements(survey):
        console.print(words)


def _right(*names: str) -> list[Column]:
    return [Column(name, justify="right") for name in names]


@click.command()
@click.argument("recording", type=PATH)
@click.option("--calibration", "calibration_path", type=PATH, required=True, help="Calibration YAML of this array.")
@click.option(
    "--index", default=3.0, show_default=True, help="Structural index: 3 dipole, 2 line of dipoles, 1 current."
)
@click.option("--frequency", type=float, help="Of an alternating source [Hz].")
@click.option("--find-frequency", is_flag=True, help="Find the frequency of an alternating source.")
@click.option("--velocity", help="X,Y,Z of a platform that goes straight [m/s], in the world of the attitude.")
@click.option("--velocity-error", type=float, help="Its standard error along each axis [m/s]; else a tenth of it.")
@click.option("--place", help="LAT,LON,DATE: the regional field is that of IGRF there, instead of a fitted one.")
@click.option("--attitude-noise-deg", default=0.0, show_default=True, help="Standard deviation about each axis.")
@tolerance_option
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--report", type=PATH, help="Write an HTML page with a map.")
def command(
    recording: Path,
    calibration_path: Path,
    index: float,
    frequency: float | None,
    find_frequency: bool,
    velocity: str | None,
    velocity_error: float | None,
    place: str | None,
    attitude_noise_deg: float,
    tolerance_s: float,
    as_json: bool,
    report: Path | None,
) -> None:
    """Locate the source in RECORDING, a CSV file or a bag.

    A steady source is located in each sample, less the regional field; with --velocity the dipoles of a straight track
    from all samples together. An alternating source is located in each pose in which the array stood still.
    """
    is_alternating = frequency is not None or find_frequency
    _check(frequency, find_frequency, is_alternating and bool(velocity or place or attitude_noise_deg))
    if not 0 <= attitude_noise_deg <= 180:
        raise InputError(f"--attitude-noise-deg must not be negative, nor above 180, not {attitude_noise_deg:g}")
    if velocity_error is not None and (velocity is None or not 0 <= velocity_error < np.inf):
        raise InputError("--velocity-error is that of --velocity: a finite number of m/s, not negative")
    regional = None if place is None else field_at(place)
    speed = None if velocity is None else _vector(velocity)
    noise = float(from_degrees(attitude_noise_deg))
    calibration = read_calibration(calibration_path)
    with write_together({"report": report}, [recording, calibration_path]) as beside:
        data = _read(recording, calibration, tolerance_s)
        if is_alternating:
            survey = locate_alternating(data, calibration, frequency, index=index)
        else:
            survey = locate_steady(
                data,
                calibration,
                index=index,
                regional_T=regional,
                regional_covariance_T2=LOCAL_VARIANCE_T2,
                attitude_noise=noise,
                velocity_m_per_s=speed,
                velocity_error_m_per_s=velocity_error,
            )
        if "report" in beside:
            from tam_calibration.report.survey_report import write_survey_report

            write_survey_report(beside["report"], survey, recording.name)
    _print(survey, as_json, report)


def _check(frequency: float | None, find_frequency: bool, is_mixed: bool) -> None:
    if frequency is not None and find_frequency:
        raise InputError("the frequency is either given or found: leave out --frequency or --find-frequency")
    if is_mixed:
        raise InputError("--velocity, --place and --attitude-noise-deg are for steady sources: leave out the frequency")


def _vector(words: str) -> FloatArray:
    try:
        values = np.array([float(word) for word in words.split(",")])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (3,) or not np.isfinite(values).all():
        raise InputError(f"--velocity must be X,Y,Z in m/s such as 1.5,0,0, not {words!r}")
    return values


def _read(path: Path, calibration: Calibration, tolerance_s: float) -> Recording:
    with showing_progress() as progress:
        array = calibration.array
        return read_samples(path, array.sensor_count, tolerance_s, reading(progress), array).recording


def _print(survey: Survey, as_json: bool, report: Path | None) -> None:
    if as_json:
        from tam_calibration.files.results_json import survey_to_mapping

        click.echo(to_json(survey_to_mapping(survey)))
        return

    _print_survey(stdout(), survey)
    if report is not None:
        click.echo(f"written: {report}")
