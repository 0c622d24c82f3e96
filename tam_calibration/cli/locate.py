"""`tam locate`: where the sources in recordings are."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
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
from tam_calibration.localization.target import Target
from tam_calibration.localization.target_list import merged
from tam_calibration.localization.targets import SurveyLine, find_targets, path_in
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import LOCAL_VARIANCE_T2, field_at
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.recordings.reading import Reading
from tam_calibration.recordings.recording_file import read_source
from tam_calibration.report import target_rows
from tam_calibration.report.blocks import Text
from tam_calibration.report.survey_rows import answer, sample_blocks, source_blocks, statements
from tam_calibration.results import read_calibration
from tam_calibration.results.targets_file import Origin, require_table, write_targets


@click.command()
@click.argument("recordings", type=terminal.PATH, nargs=-1, required=True)
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
@click.option("--targets", "table", type=terminal.PATH, help="Write the targets of lines as a table: .csv or .geojson.")
@click.option(
    "--origin",
    help="LAT,LON or LAT,LON,HEIGHT [°, m] where x = y = z = 0: geographic positions count from there, and the "
    "table has latitudes and longitudes.",
)
@terminal.reading_options
@terminal.answer_options
@click.option("--json", "as_json", is_flag=True, help="Print the result as JSON.")
@click.option("--report", type=terminal.PATH, help="Write an HTML page with a map.")
def command(
    recordings: tuple[Path, ...],
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
    table: Path | None,
    origin: str | None,
    how: Reading,
    detail: terminal.Detail,
    as_json: bool,
    report: Path | None,
) -> None:
    """Locate the sources in RECORDINGS, of any format.

    With positions of the platform, or --velocity on a straight track, all targets along each line are found from all
    samples together, and several lines give one list. Otherwise a steady source is located in each sample, after the
    regional field is subtracted. An alternating source is located in each pose in which the array was at rest.
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
    speed = None if velocity is None else _numbers("--velocity", "X,Y,Z in m/s such as 1.5,0,0", velocity, (3,))
    begin = None if origin is None else _origin(origin)
    if table is not None:
        require_table(table, begin)
    noise = float(from_degrees(attitude_noise_deg))
    calibration = read_calibration(calibration_path)
    inputs = [*recordings, calibration_path, *how.files]
    outputs = terminal.write_together({"report": report, "table": table}, inputs)
    with _graded(as_json), outputs as beside:
        data = [_read(each, calibration.array, replace(how, origin=begin)) for each in recordings]
        is_line = all(each.position_m is not None for each in data) and index == DIPOLE_INDEX and place is None
        if speed is not None or (is_line and not is_alternating):
            _require_dipoles(index, place)
            _require_one_frame(data)
            stated = speed, velocity_error, position_error_m, position_drift_m or 0.0
            lines = [find_targets(each, calibration, path_in(each, *stated), noise) for each in data]
            targets = merged([each.targets for each in lines])
            _write(beside, lines, targets, recordings, begin, table)
            result: Survey | list[Target] = targets
        else:
            _require_one(data, position_error_m is not None or position_drift_m is not None, table)
            if is_alternating:
                result = locate_alternating(data[0], calibration, frequency, index=index)
            else:
                result = locate_steady(
                    data[0],
                    calibration,
                    index=index,
                    regional_T=regional,
                    regional_covariance_T2=LOCAL_VARIANCE_T2,
                    attitude_noise=noise,
                )
            if "report" in beside:
                from tam_calibration.report.survey_report import write_survey_report

                write_survey_report(beside["report"], result, recordings[0].name)
    if isinstance(result, list):
        _print_targets(result, as_json, [report, table], detail)
    else:
        _print(result, as_json, report, detail)


def _read(path: Path, array: Array, how: Reading) -> Recording:
    with terminal.showing_progress() as progress:
        source, usage = read_source(path, array, how, terminal.reading(progress))
        data = source.whole()
    for remark in () if usage is None else usage.missing:
        say(f"warning: {remark}", err=True)
    return data


def _require_dipoles(index: float, place: str | None) -> None:
    if index != DIPOLE_INDEX:
        raise InputError(
            f"along a line dipoles are located: its structural index is 3, not {index:g}; leave out positions and "
            "velocity, and each sample is located by itself"
        )
    if place is not None:
        raise InputError("along a line the regional field is fitted: leave out --place")


def _require_one_frame(data: list[Recording]) -> None:
    """Check that positions of several recordings do not all count from the begin of their own."""
    starts = [each.position_m[0] for each in data if each.position_m is not None]
    if len(data) > 1 and (len(starts) < len(data) or sum(not start.any() for start in starts) > 1):
        raise InputError(
            "several lines need positions in one frame, and these begin at 0, 0, 0 or have none: record x_m, y_m, z_m "
            "of one frame, or state the --origin from which latitudes and longitudes count"
        )


def _require_one(data: list[Recording], has_errors: bool, table: Path | None) -> None:
    if len(data) > 1:
        raise InputError("several recordings are located as survey lines alone, and one has no positions")
    if table is not None:
        raise InputError(
            "--targets is of survey lines: record positions or state --velocity, and leave out --index, --place"
        )
    if has_errors:
        raise InputError("--position-error-m and --position-drift-m are those of positions, of which there are none")


def _write(
    beside: dict[str, Path],
    lines: list[SurveyLine],
    targets: list[Target],
    recordings: tuple[Path, ...],
    origin: Origin | None,
    table: Path | None,
) -> None:
    """Write the table and the page that are wanted."""
    if table is not None:
        write_targets(beside["table"], targets, origin, suffix=table.suffix)
    if "report" in beside:
        from tam_calibration.report.targets_report import write_targets_report

        write_targets_report(beside["report"], lines, targets, [each.name for each in recordings])


@contextmanager
def _graded(as_json: bool) -> Iterator[None]:
    """Answer a refusal by its reason: in words, or as JSON without targets."""
    try:
        yield
    except Refused as problem:
        raise GradedBad(str(problem), as_json, {"targets": [], "refused": str(problem)}) from problem


def _print_targets(targets: list[Target], as_json: bool, written: list[Path | None], detail: terminal.Detail) -> None:
    if as_json:
        from tam_calibration.results.targets_json import targets_to_mapping

        say(to_json(targets_to_mapping(targets)))
        return
    table = target_rows.target_table(targets)
    terminal.print_answer(target_rows.answer(targets), [table] * bool(targets), [table], detail, written)


def _check(frequency: float | None, find_frequency: bool, is_mixed: bool) -> None:
    if frequency is not None and find_frequency:
        raise InputError("the frequency is either given or found: leave out --frequency or --find-frequency")
    if is_mixed:
        raise InputError("--velocity, --place and --attitude-noise-deg are for steady sources: leave out the frequency")


def _origin(words: str) -> Origin:
    values = _numbers("--origin", "LAT,LON or LAT,LON,HEIGHT such as 54.3,10.1", words, (2, 3))
    latitude, longitude, *height = values.tolist()
    if abs(latitude) > 90 or abs(longitude) > 360:
        raise InputError(f"--origin must be a latitude and a longitude in degrees, not {words!r}")
    return latitude, longitude, height[0] if height else 0.0


def _numbers(option: str, form: str, words: str, counts: tuple[int, ...]) -> FloatArray:
    try:
        values = np.array([float(word) for word in words.split(",")])
    except ValueError:
        values = np.zeros(0)
    if len(values) not in counts or not np.isfinite(values).all():
        raise InputError(f"{option} must be {form}, not {words!r}")
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
