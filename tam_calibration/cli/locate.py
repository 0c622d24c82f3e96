"""`tam locate`: where the sources in recordings are."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from tam_calibration.cli import terminal
from tam_calibration.cli.answer import Answer, answering
from tam_calibration.cli.locate_options import Wanted
from tam_calibration.cli.streams import say
from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.locate import locate_steady
from tam_calibration.localization.solutions import Survey
from tam_calibration.localization.targets import field_map, find_targets, merged, path_in, require_area
from tam_calibration.model.array import Array
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2
from tam_calibration.model.recording import Recording
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.recordings.reading import Reading
from tam_calibration.report import survey_rows
from tam_calibration.report.blocks import Block, Text
from tam_calibration.results import read_calibration, targets_file


@click.command()
@click.argument("recordings", type=terminal.PATH, nargs=-1, required=True)
@terminal.path_option("--calibration", "Calibration YAML of this array.", required=True)
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
@terminal.path_option("--targets", "Write the targets of lines as a table: .csv or .geojson.")
@terminal.path_option("--grid", "Write a map of the field over lines: netCDF, .nc.")
@click.option(
    "--origin",
    help="LAT,LON or LAT,LON,HEIGHT [°, m] where x = y = z = 0: geographic positions count from there, and the "
    "table has latitudes and longitudes.",
)
@terminal.reading_options
@terminal.path_option("--report", "Write an HTML page with a map.")
@answering
def command(
    recordings: tuple[Path, ...],
    calibration_path: Path,
    grid_path: Path | None,
    how: Reading,
    answer: Answer,
    report_path: Path | None,
    **asked: Any,
) -> None:
    """Locate the sources in RECORDINGS, of any format.

    With positions of the platform, or --velocity on a straight track, all targets along each line are found from all
    samples together, and several lines give one list. Otherwise a steady source is located in each sample, after the
    regional field is subtracted. An alternating source is located in each pose in which the array was at rest.
    """
    wanted = Wanted(**asked)
    if wanted.targets_path is not None:
        targets_file.require_table(wanted.targets_path, wanted.begin)
    calibration = read_calibration(calibration_path)
    inputs = [*recordings, calibration_path, *how.files]
    graded = terminal.graded(answer.is_json, lambda reason: {"targets": [], "refused": reason})
    with graded, answer.files(inputs, report=report_path, table=wanted.targets_path, grid=grid_path) as places:
        data = [_read(each, calibration.array, replace(how, origin=wanted.begin)) for each in recordings]
        if wanted.are_lines(data):
            _give_targets(data, calibration, wanted, answer, places, [each.name for each in recordings])
        else:
            wanted.require_one(data, of_lines="table" in places or "grid" in places)
            _give_survey(_located(data[0], calibration, wanted), answer, places.get("report"), recordings[0].name)


def _read(path: Path, array: Array, how: Reading) -> Recording:
    with terminal.showing_progress() as progress:
        source, usage = read_source(path, array, how, terminal.reading(progress))
        data = source.whole()
    for remark in () if usage is None else usage.missing:
        say(f"warning: {remark}", err=True)
    return data


def _located(data: Recording, calibration: Calibration, wanted: Wanted) -> Survey:
    """Return the sources of single samples, or of an alternating source."""
    if wanted.is_alternating:
        return locate_alternating(data, calibration, wanted.frequency, index=wanted.index)
    return locate_steady(
        data,
        calibration,
        index=wanted.index,
        regional_T=wanted.regional_T,
        regional_covariance_T2=LOCAL_VARIANCE_T2,
        attitude_noise=wanted.attitude_noise,
    )


def _give_targets(
    data: list[Recording],
    calibration: Calibration,
    wanted: Wanted,
    answer: Answer,
    places: dict[str, Path],
    names: list[str],
) -> None:
    """Find the targets of lines, write the table, map and page that are wanted, and give the answer."""
    error_m, drift_m = wanted.position_error_m, wanted.position_drift_m or 0.0
    paths = [path_in(each, wanted.speed, wanted.velocity_error, error_m, drift_m) for each in data]
    if "grid" in places:
        require_area([path.at(each.time_s) for path, each in zip(paths, data, strict=True)])
    lines = [
        find_targets(each, calibration, path, wanted.attitude_noise) for path, each in zip(paths, data, strict=True)
    ]
    targets = merged([each.targets for each in lines])
    if wanted.targets_path is not None:
        targets_file.write_targets(places["table"], targets, wanted.begin, suffix=wanted.targets_path.suffix)
    if "grid" in places:
        targets_file.write_map(places["grid"], field_map(lines), wanted.begin)
    if "report" in places:
        from tam_calibration.report.survey_report import write_targets_report

        write_targets_report(places["report"], lines, targets, names)
    rows = survey_rows.target_table(targets)
    notes = [f"{name}: {line.note}." for name, line in zip(names, lines, strict=True) if line.note]
    below = [*map(Text, notes)]
    few: list[Block] = [rows, *below] if targets else [*below]
    mapping = targets_file.targets_to_mapping(targets, notes)
    answer.give(mapping, survey_rows.targets_answer(targets), few, [rows, *below])


_FEW = 5
"""Samples that a summary shows."""


def _give_survey(survey: Survey, answer: Answer, report: Path | None, name: str) -> None:
    """Write the page that is wanted, and give the answer."""
    if report is not None:
        from tam_calibration.report.survey_report import write_survey_report

        write_survey_report(report, survey, name)
    words = [Text(each) for each in survey_rows.statements(survey)]
    tables = [*survey_rows.source_blocks(survey), *survey_rows.sample_blocks(survey), *words]
    few = [*words, *([] if survey.overall else survey_rows.sample_blocks(survey, _FEW))]
    answer.give(targets_file.survey_to_mapping(survey), survey_rows.survey_answer(survey), few, tables)
