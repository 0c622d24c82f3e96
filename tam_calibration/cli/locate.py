"""`tam locate`: where the source in a recording is."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import click
import numpy as np

from tam_calibration.cli import terminal
from tam_calibration.cli.streams import GradedBad, say
from tam_calibration.files.text_files import to_json
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.steady import locate_steady
from tam_calibration.localization.survey import Survey
from tam_calibration.localization.target_line import locate_line
from tam_calibration.localization.targets import Target
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2, field_at
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.recordings.reading import Reading
from tam_calibration.recordings.recording_file import read_source
from tam_calibration.report import target_rows
from tam_calibration.report.blocks import Text
from tam_calibration.report.survey_rows import answer, sample_blocks, source_blocks, statements
from tam_calibration.results import read_calibration


@click.command()
@click.argument("recording", type=terminal.PATH)
@click.option(
    "--calibration", "calibration_path", type=terminal.PATH, required=True, help="Calibration YAML of this array."
)
@click.option(
    "--index", default=3.0, show_default=True, help="Structural index: 3 dipole, 2 line of dipoles, 1 current."
)
@click.option("--frequency", type=float, help="Frequency of an alternating source [Hz].")
@click.option("--find-frequency", is_flag=True, help="Find the frequency of an alternating source.")
@click.option("--velocity", help="X,Y,Z of a platform on a straight track [m/s], in the world of the attitude.")
@click.option(
    "--velocity-error",
    type=float,
    help="Standard error of the velocity along each axis [m/s]; by default a tenth of the speed.",
)
@click.option("--position-error-m", type=float, help="White error of recorded positions [m]; by default estimated.")
@click.option("--position-drift-m", type=float, help="Slow error of recorded positions over the line [m].")
@click.option("--place", help="LAT,LON,DATE: take the regional field from IGRF instead of fitting it.")
@click.option(
    "--attitude-noise-deg", default=0.0, show_default=True, help="Standard deviation of the attitude about each axis."
)
@terminal.reading_options
@terminal.answer_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--report", type=terminal.PATH, help="Write an HTML page with a map.")
def command(
    recording: Path,
    calibration_path: Path,
    index: float,
    frequency: float | None,
    find_frequency: bool,
    velocity: str | None,
    velocity_error: float | None,
    position_error_m: float | None,
    position_drift_m: float | None,
    place: str | None,
    attitude_noise_deg: float,
    how: Reading,
    detail: terminal.Detail,
    as_json: bool,
    report: Path | None,
) -> None:
    """Locate the source in RECORDING, of any format.

    With positions of the platform, or --velocity on a straight track, all targets along the line are found from all
    samples together. Otherwise a steady source is located in each sample, after the regional field is subtracted. An
    alternating source is located in each pose in which the array was at rest.
    """
    is_alternating = frequency is not None or find_frequency
    _check(frequency, find_frequency, is_alternating and bool(velocity or place or attitude_noise_deg))
    if not 0 <= attitude_noise_deg <= 180:
        raise InputError(f"--attitude-noise-deg must not be negative, nor above 180, not {attitude_noise_deg:g}")
    if velocity_error is not None and (velocity is None or not 0 <= velocity_error < np.inf):
        raise InputError("--velocity-error is that of --velocity: a finite number of m/s, not negative")
    for name, value in (("error", position_error_m), ("drift", position_drift_m)):
        if value is not None and not 0 <= value < np.inf:
            raise InputError(f"--position-{name}-m must be a finite number of metres, not negative, not {value:g}")
    regional = None if place is None else field_at(place)
    speed = None if velocity is None else _vector(velocity)
    noise = float(from_degrees(attitude_noise_deg))
    calibration = read_calibration(calibration_path)
    inputs = [recording, calibration_path, *how.files]
    with _graded(as_json), terminal.write_together({"report": report}, inputs) as beside:
        with terminal.showing_progress() as progress:
            source, usage = read_source(recording, calibration.array, how, terminal.reading(progress))
            data = source.whole()
        for remark in () if usage is None else usage.missing:
            say(f"warning: {remark}", err=True)
        survey: Survey | list[Target]
        if is_alternating:
            survey = locate_alternating(data, calibration, frequency, index=index)
        elif data.position_m is None and (position_error_m is not None or position_drift_m is not None):
            raise InputError(
                "--position-error-m and --position-drift-m are those of positions, of which there are none"
            )
        elif index == DIPOLE_INDEX and place is None and (speed is not None or data.position_m is not None):
            error = position_error_m, position_drift_m or 0.0
            survey = locate_line(data, calibration, noise, speed, velocity_error, *error)
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
            if isinstance(survey, list):
                raise InputError("a page is written of one or two sources: print the targets of a line with --json")
            from tam_calibration.report.survey_report import write_survey_report

            write_survey_report(beside["report"], survey, recording.name)
    if isinstance(survey, list):
        _print_targets(survey, as_json, detail)
    else:
        _print(survey, as_json, report, detail)


@contextmanager
def _graded(as_json: bool) -> Iterator[None]:
    """Answer a refusal by its reason: in words, or as JSON without targets."""
    try:
        yield
    except Refused as problem:
        raise GradedBad(str(problem), as_json, {"targets": [], "refused": str(problem)}) from problem


def _print_targets(targets: list[Target], as_json: bool, detail: terminal.Detail) -> None:
    if as_json:
        from tam_calibration.results.targets_json import targets_to_mapping

        say(to_json(targets_to_mapping(targets)))
        return
    table = target_rows.target_table(targets)
    terminal.print_answer(target_rows.answer(targets), [table] * bool(targets), [table], detail)


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


_FEW = 5
"""Samples that a summary shows."""


def _print(survey: Survey, as_json: bool, report: Path | None, detail: terminal.Detail) -> None:
    if as_json:
        from tam_calibration.results.targets_json import survey_to_mapping

        say(to_json(survey_to_mapping(survey)))
        return
    words = [Text(each) for each in statements(survey)]
    tables = [*source_blocks(survey), *sample_blocks(survey), *words]
    few = [*words, *([] if survey.overall else sample_blocks(survey, _FEW))]
    terminal.print_answer(answer(survey), few, tables, detail, [report])
