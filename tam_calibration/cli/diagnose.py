"""`tam diagnose`: where a recording and its simulation part, and which effect causes it."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import click
from rich.progress import Progress

from tam_calibration.array import Array
from tam_calibration.cli.terminal import (
    PATH,
    reading,
    showing_progress,
    stdout,
    tolerance_option,
    write_together,
)
from tam_calibration.effects.library import effect_named
from tam_calibration.exceptions import InputError
from tam_calibration.field_bounds import EARTH_FIELD
from tam_calibration.files import provenance, read_array, read_calibration, read_samples
from tam_calibration.files.gap_json import gap_to_mapping
from tam_calibration.files.json_text import to_json
from tam_calibration.gap import diagnose
from tam_calibration.gap.result import Gap
from tam_calibration.geomagnetic import bounds_at

_ANSWERS = ("no_gap", "explained")
"""Verdicts that leave nothing open."""


@click.command()
@click.argument("recording", type=PATH)
@click.option("--array", type=PATH, required=True, help="Array YAML: where the sensors sit, and their noise.")
@click.option("--json", "json_path", type=PATH, help="Write the result as JSON; - is stdout, instead of the tables.")
@click.option("--report", type=PATH, help="Write an HTML page: where the gap is, its causes, what they leave.")
@click.option("--without", multiple=True, metavar="EFFECT", help="Leave an effect out of those tried; may be repeated.")
@click.option(
    "--calibration",
    "calibration_path",
    type=PATH,
    help="Calibration YAML whose effects are taken off first: what is left is the gap that they do not explain.",
)
@click.option(
    "--place",
    help="LAT,LON,DATE of the recording: its field has the intensity of IGRF there, but for what iron nearby makes of "
    "it. A scalar reference that contradicts it is bad input.",
)
@tolerance_option
@click.pass_context
def command(
    ctx: click.Context,
    recording: Path,
    array: Path,
    json_path: Path | None,
    report: Path | None,
    without: tuple[str, ...],
    calibration_path: Path | None,
    place: str | None,
    tolerance_s: float,
) -> None:
    """Say whether RECORDING (a CSV file or a bag) holds more than the model and the noise can make, where, and why.

    Exits 0 when there is no gap or its causes are found, 1 when some of it stays unexplained or the recording is too
    short to tell, 2 on bad input.
    """
    to_stdout = json_path == Path("-")
    outputs = {"json": None if to_stdout else json_path, "report": report}
    inputs = [path for path in (recording, array, calibration_path) if path is not None]
    with write_together(outputs, inputs) as beside:
        gap = _diagnose(recording, _read_array(array, place), without, calibration_path, tolerance_s)
        source = provenance(recording)
        content = to_json(gap_to_mapping(gap, source))
        if "json" in beside:
            beside["json"].write_text(content, encoding="utf-8")
        if "report" in beside:
            from tam_calibration.report.gap_report import write_gap_report  # late, as it brings matplotlib with it

            write_gap_report(beside["report"], gap, source)
    if to_stdout:
        click.echo(content)
    else:
        _print(gap, [path for path in outputs.values() if path])
    ctx.exit(0 if gap.verdict in _ANSWERS else 1)


def _diagnose(
    path: Path, array: Array, without: tuple[str, ...], calibration_path: Path | None, tolerance_s: float
) -> Gap:
    for name in without:
        effect_named(name)
    calibration = None if calibration_path is None else read_calibration(calibration_path)
    with showing_progress() as progress:
        recording = read_samples(path, array.sensor_count, tolerance_s, reading(progress)).recording
        if calibration is not None:
            recording = calibration.without_effects(recording)
        return diagnose(recording, array, without=without, progress=_diagnosing(progress))


def _read_array(path: Path, place: str | None) -> Array:
    """Return the array, in the field of a place where one is given."""
    array = read_array(path)
    if place is None:
        return array
    if array.field != EARTH_FIELD:
        raise InputError(f"--place and intensity_nT in {path} both tell the field: leave one of them out")
    return replace(array, field=bounds_at(place))


def _diagnosing(progress: Progress) -> Callable[[str, float], None]:
    """Return a callback that shows the stage of the diagnosis, and how much of it is done."""
    task = progress.add_task("diagnosing", total=1.0)
    return lambda stage, done: progress.update(task, description=stage, completed=done)


def _print(gap: Gap, written: list[Path]) -> None:
    from tam_calibration.cli.gap_table import print_gap

    print_gap(stdout(), gap)
    for path in written:
        click.echo(f"written: {path}")
