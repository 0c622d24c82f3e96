"""`tam locate`: where the sources in recordings are."""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import click
import numpy as np

from tam_calibration.cli import terminal
from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import Answer, answering, numbers_in
from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.locate import locate_steady
from tam_calibration.localization.solutions import Survey
from tam_calibration.localization.targets import field_map, find_targets, merged, path_in, require_area
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import field_at
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.report import survey_report
from tam_calibration.report.blocks import Text
from tam_calibration.results import read_calibration, targets_file
from tam_calibration.results.targets_file import Origin


@dataclass(frozen=True)
class Wanted:
    """What the options ask for, as they were given.

    Raises
    ------
    InputError
        When a value is out of its range, or options exclude each other.
    """

    index: float
    frequency: float | None
    find_frequency: bool
    velocity: str | None
    velocity_error: float | None
    position_error_m: float | None
    position_drift_m: float | None
    place: str | None
    attitude_noise_deg: float
    origin: str | None
    targets_path: Path | None

    def __post_init__(self) -> None:
        """Check each option, and those that exclude each other."""
        if self.frequency is not None and self.find_frequency:
            raise InputError("the frequency is either given or found: leave out --frequency or --find-frequency")
        if self.is_alternating and (self.velocity or self.place or self.attitude_noise_deg):
            raise InputError(
                "--velocity, --place and --attitude-noise-deg are for steady sources: leave out the frequency"
            )
        if not 0 <= self.attitude_noise_deg <= 180:
            raise InputError(
                f"--attitude-noise-deg must not be negative, nor above 180, not {self.attitude_noise_deg:g}"
            )
        error = self.velocity_error
        if error is not None and (self.velocity is None or not 0 <= error < np.inf):
            raise InputError("--velocity-error is that of --velocity: a finite number of m/s, not negative")
        for name, value in (("error", self.position_error_m), ("drift", self.position_drift_m)):
            if value is not None and not 0 <= value < np.inf:
                raise InputError(f"--position-{name}-m must be a finite number of metres, not negative, not {value:g}")
        _ = self.regional_T, self.speed, self.begin

    @property
    def is_alternating(self) -> bool:
        """Whether an alternating source is located."""
        return self.frequency is not None or self.find_frequency

    @cached_property
    def regional_T(self) -> FloatArray | None:
        """(3,) regional field of the place, tesla, in east, north, up; None where it is fitted."""
        return None if self.place is None else field_at(self.place)

    @cached_property
    def speed(self) -> FloatArray | None:
        """(3,) velocity on a straight track, m/s; None without one."""
        if self.velocity is None:
            return None
        velocity = numbers_in("--velocity", "X,Y,Z in m/s such as 1.5,0,0", self.velocity, (3,))
        if not velocity.any():
            raise InputError("--velocity is zero, and a platform that stays draws no line: leave it out")
        return velocity

    @cached_property
    def begin(self) -> Origin | None:
        """Latitude, longitude (degrees) and height (metres) where x = y = z = 0; None without ``--origin``."""
        if self.origin is None:
            return None
        values = numbers_in("--origin", "LAT,LON or LAT,LON,HEIGHT such as 54.3,10.1", self.origin, (2, 3))
        latitude, longitude, *height = values.tolist()
        if abs(latitude) > 90 or abs(longitude) > 360:
            raise InputError(f"--origin must be a latitude and a longitude in degrees, not {self.origin!r}")
        return latitude, longitude, height[0] if height else 0.0

    def are_lines(self, data: list[Recording]) -> bool:
        """Say whether recordings are survey lines.

        Raises
        ------
        InputError
            When they are, and options or positions do not suit lines.
        """
        has_positions = all(each.position_m is not None for each in data)
        is_plain = self.index == DIPOLE_INDEX and self.place is None and not self.is_alternating
        if self.velocity is None and not (has_positions and is_plain):
            return False
        if self.index != DIPOLE_INDEX:
            raise InputError(
                f"along a line dipoles are located: its structural index is 3, not {self.index:g}; leave out positions "
                "and velocity, and each sample is located by itself"
            )
        if self.place is not None:
            raise InputError("along a line the regional field is fitted: leave out --place")
        _require_one_frame(data)
        return True

    def require_one(self, data: list[Recording], of_lines: bool) -> None:
        """Check that a single recording without the options of lines is given.

        Raises
        ------
        InputError
            When there are more, or an option of lines.
        """
        if len(data) > 1:
            raise InputError("several recordings are located as survey lines alone, and one has no positions")
        if of_lines:
            raise InputError(
                "--targets and --grid are of survey lines: record positions or state --velocity, and leave out "
                "--index and --place"
            )
        if self.position_error_m is not None or self.position_drift_m is not None:
            raise InputError(
                "--position-error-m and --position-drift-m are those of positions, of which there are none"
            )


def _require_one_frame(data: list[Recording]) -> None:
    """Check that positions of several recordings do not all count from the begin of their own."""
    starts = [each.position_m[0] for each in data if each.position_m is not None]
    if len(data) > 1 and (len(starts) < len(data) or sum(not start.any() for start in starts) > 1):
        raise InputError(
            "several lines need positions in one frame, and these begin at 0, 0, 0 or have none: record x_m, y_m, z_m "
            "of one frame, or state the --origin from which latitudes and longitudes count"
        )


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
    for remark in usage.missing:
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
        attitude_noise=from_degrees(wanted.attitude_noise_deg),
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
    noise = from_degrees(wanted.attitude_noise_deg)
    lines = [find_targets(each, calibration, path, noise) for path, each in zip(paths, data, strict=True)]
    targets = merged([each.targets for each in lines])
    if wanted.targets_path is not None:
        targets_file.write_targets(places["table"], targets, wanted.begin, suffix=wanted.targets_path.suffix)
    if "grid" in places:
        targets_file.write_map(places["grid"], field_map(lines), wanted.begin)
    if "report" in places:
        from tam_calibration.report.survey_report import write_targets_report

        write_targets_report(places["report"], lines, targets, names)
    rows = survey_report.target_table(targets)
    notes = [f"{name}: {line.note}." for name, line in zip(names, lines, strict=True) if line.note]
    below = [*map(Text, notes)]
    mapping = targets_file.targets_to_mapping(targets, notes)
    answer.give(mapping, survey_report.targets_answer(targets), [rows, *below] if targets else below, [rows, *below])


def _give_survey(survey: Survey, answer: Answer, report: Path | None, name: str) -> None:
    """Write the page that is wanted, and give the answer."""
    if report is not None:
        from tam_calibration.report.survey_report import write_survey_report

        write_survey_report(report, survey, name)
    words = [Text(each) for each in survey_report.statements(survey)]
    tables = [*survey_report.source_blocks(survey), *survey_report.sample_blocks(survey), *words]
    few = [*words, *([] if survey.overall else survey_report.sample_blocks(survey, terminal.FEW))]
    answer.give(targets_file.survey_to_mapping(survey), survey_report.survey_answer(survey), few, tables)
