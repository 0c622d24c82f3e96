"""`tam diagnose`: where a recording and its simulation part, and which effect causes it."""

from dataclasses import replace
from pathlib import Path

import click
from rich.console import Console

from tam_calibration.cli.terminal import (
    PATH,
    progress_of,
    reading,
    showing_progress,
    stdout,
    table_of,
    tolerance_option,
    write_together,
)
from tam_calibration.effects.library import effect_named
from tam_calibration.files import provenance, read_array, read_calibration
from tam_calibration.files.bag_transforms import transforms_in
from tam_calibration.files.recording_file import read_source
from tam_calibration.files.results_json import gap_to_mapping
from tam_calibration.files.text_files import to_json
from tam_calibration.gap import diagnose
from tam_calibration.gap.result import Cause, Gap
from tam_calibration.gap.stretches import in_stretches
from tam_calibration.integrity import ACCEPTABLE
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, bounds_at
from tam_calibration.report.formatting import sentence
from tam_calibration.report.gap_rows import (
    CAUSES_HEADER,
    NOISE_HEADER,
    SIZE_HEADER,
    cause_row,
    cause_words,
    closed_words,
    noise_rows,
    parameter_rows,
    place,
    set_words,
    size_rows,
    unseen_words,
    where_words,
)

_ROWS = 12
_WORDS = ("where", "unit", "cannot be told from")
"""Columns that hold words."""

_LEFT = "What is left with the causes, and the simulated twin does not have:"


def _print_gap(console: Console, gap: Gap) -> None:
    """Print the verdict, the size, where it lies, its causes, what became of each hypothesis, and what to record."""
    sensor_count = len(gap.residue.floor_T) // 3
    for remark in gap.remarks:
        console.print(remark, soft_wrap=True)
    console.print(gap.headline, style="bold", soft_wrap=True)
    if gap.verdict != "not_identifiable":
        console.print(table_of(SIZE_HEADER, size_rows(gap.size)))
    if gap.floor is not None:
        console.print(table_of(NOISE_HEADER, noise_rows(gap.floor)))
    if gap.where.sensors:
        console.print(f"Where: {where_words(gap.where, sensor_count)}.")
    if gap.causes:
        console.print(f"{sentence(closed_words(gap.size))}")
        console.print(table_of(CAUSES_HEADER, [cause_row(cause, sensor_count) for cause in gap.causes], _WORDS))
    for cause in gap.causes:
        _print_parameters(console, cause, place(cause.sensors, cause.axes, sensor_count))
        for words in cause_words(cause):
            console.print(f"  {words}", soft_wrap=True)
    if gap.remainder:
        console.print(f"What no cause explains: {gap.remainder}", soft_wrap=True)
    for words in (*set_words(gap), *unseen_words(gap)):
        console.print(words, soft_wrap=True)
    if gap.checks is not None and gap.checks.sentences:
        console.print("What the simulated twin does not have:" if not gap.causes else _LEFT)
        for words in gap.checks.sentences:
            console.print(f"  {words}", soft_wrap=True)
    console.print("Hypotheses:")
    for considered in gap.considered:
        status = considered.status.replace("_", " ")
        console.print(f"  {considered.effect}: {status}, {considered.why}", soft_wrap=True)
    if gap.next_recording:
        console.print(f"Next recording: {sentence(gap.next_recording)}")


def _print_parameters(console: Console, cause: Cause, where: str) -> None:
    rows = parameter_rows(cause)
    if not rows:
        return
    console.print(f"{cause.fitted.effect} of {where}:")
    console.print(table_of(("parameter", "value ± standard error", "unit"), rows[:_ROWS], _WORDS))
    if len(rows) > _ROWS:
        console.print(f"… and {len(rows) - _ROWS} more: --json and --report have all.")


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
@click.option(
    "--accept", multiple=True, metavar="NAME", help=f"Overrule a finding; may be repeated: {', '.join(ACCEPTABLE)}."
)
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
    accept: tuple[str, ...],
) -> None:
    """Say whether RECORDING (a CSV file or a bag) holds more than the model and the noise can make, where, and why.

    Exits 0 when there is no gap or its causes are found, 1 when some of it stays unexplained or the recording is too
    short to tell, 2 on bad input.
    """
    to_stdout = json_path == Path("-")
    outputs = {"json": None if to_stdout else json_path, "report": report}
    inputs = [path for path in (recording, array, calibration_path) if path is not None]
    with write_together(outputs, inputs) as beside:
        found = _read_array(array, recording, place)
        gap, usage = _diagnose(recording, found, without, calibration_path, tolerance_s, accept)
        source = provenance(recording)
        content = to_json(gap_to_mapping(gap, source))
        if "json" in beside:
            beside["json"].write_text(content, encoding="utf-8")
        if "report" in beside:
            from tam_calibration.report.gap_report import write_gap_report

            write_gap_report(beside["report"], gap, source)
    if to_stdout:
        click.echo(content)
    else:
        _print(gap, usage, [path for path in outputs.values() if path])
    ctx.exit(0 if gap.verdict in _ANSWERS else 1)


def _diagnose(
    path: Path,
    array: Array,
    without: tuple[str, ...],
    calibration_path: Path | None,
    tolerance_s: float,
    accept: tuple[str, ...],
) -> tuple[Gap, Usage | None]:
    """Return the diagnosis of a recording, and how many of its samples were used."""
    for name in without:
        effect_named(name)
    calibration = None if calibration_path is None else read_calibration(calibration_path)
    with showing_progress() as progress:
        source, usage = read_source(path, array.sensor_count, tolerance_s, reading(progress), array)
        remarks = () if usage is None else usage.remarks()
        if calibration is not None:
            if not calibration.is_of(array):
                raise InputError(f"{calibration_path} is the calibration of another array: use the one of this array")
            seen, of_stretches = in_stretches(source)
            source, remarks = calibration.without_effects(seen), (*remarks, *of_stretches)
        if usage is not None:
            source = usage.with_each_reading_once(source)
        gap = diagnose(source, array, without=without, progress=progress_of(progress, "diagnosing"), accept=accept)
    return replace(gap, remarks=(*remarks, *gap.remarks)), usage


def _read_array(path: Path, recording: Path, place: str | None) -> Array:
    """Return the array, in the field of a place where one is given."""
    array = read_array(path, transforms_in(recording))
    if place is None:
        return array
    if array.field != EARTH_FIELD:
        raise InputError(f"--place and intensity_nT in {path} both tell the field: leave one of them out")
    return replace(array, field=bounds_at(place))


def _print(gap: Gap, usage: Usage | None, written: list[Path]) -> None:
    console = stdout()
    _print_gap(console, gap)
    if usage is not None:
        console.print(sentence(str(usage)), soft_wrap=True)
    for path in written:
        click.echo(f"written: {path}")
