"""`tam diagnose`: where a recording and its simulation part, and which effect causes it."""

from dataclasses import replace
from pathlib import Path

import click

from tam_calibration.cli import terminal
from tam_calibration.cli.terminal import Answer, answering
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.gap import diagnose
from tam_calibration.gap.diagnose import in_stretches
from tam_calibration.gap.result import Gap
from tam_calibration.messages.samples import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, bounds_at
from tam_calibration.recordings import provenance, read_array, transforms_in
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.report import gap_rows
from tam_calibration.report.blocks import Block, Points, Text, sentence
from tam_calibration.report.gap_rows import first_sentence, law_blocks
from tam_calibration.results import read_calibration
from tam_calibration.results.results_json import gap_to_mapping


def _blocks(gap: Gap) -> list[Block]:
    """Return the size of the gap, its causes, where it lies, what became of each hypothesis, and what to record."""
    blocks = [*law_blocks(gap), *gap_rows.size_blocks(gap)]
    if gap.where.sensors:
        blocks.append(Text(f"Where: {gap_rows.where_words(gap)}."))
    if gap.causes:
        blocks += gap_rows.cause_blocks(gap)
    if gap.checks is not None and gap.checks.sentences:
        left = "What remains with the causes, and" if gap.causes else "What"
        blocks += [Text(f"{left} the simulated twin does not have:"), Points(gap.checks.sentences)]
    return [*blocks, Text("Hypotheses:"), gap_rows.hypotheses(gap.considered), *gap_rows.next_blocks(gap)]


@click.command()
@click.argument("recording", type=terminal.PATH)
@terminal.array_option
@click.option("--report", type=terminal.PATH, help="Write an HTML page: where the gap is, its causes, and the rest.")
@click.option(
    "--without",
    multiple=True,
    metavar="EFFECT",
    shell_complete=terminal.completed(installed_effects),
    help="Do not name this effect as a cause; may be repeated.",
)
@terminal.path_option(
    "--calibration", "Calibration YAML whose effects are removed first: the gap that they do not explain remains."
)
@click.option(
    "--place",
    help="LAT,LON,DATE: limit the intensity of the field to that of IGRF there, within a factor of 1.5. A scalar "
    "reference that contradicts it is bad input.",
)
@terminal.reading_options
@answering
@terminal.accept_option
def command(
    recording: Path,
    array_path: Path,
    report: Path | None,
    without: tuple[str, ...],
    calibration_path: Path | None,
    place: str | None,
    how: Reading,
    answer: Answer,
    accept: tuple[str, ...],
) -> None:
    """Find what RECORDING, of any format, contains beyond model and noise, where, and why.

    Exits 0 when there is no gap or its causes are found, 1 when some of it stays unexplained or the recording is too
    short to tell, 2 on bad input.
    """
    inputs = [recording, array_path, calibration_path, *how.files]
    with terminal.graded(answer.is_json), answer.files(inputs, report=report) as places:
        array = _read_array(array_path, recording, place)
        gap, usage = _diagnose(recording, array, without, calibration_path, how, accept)
        source = provenance(recording)
        if "report" in places:
            from tam_calibration.report.gap_report import write_gap_report

            write_gap_report(places["report"], gap, source)
        used = [Text(sentence(str(usage)))] if usage.received else []
        effects = ",".join(gap.named)
        words = ("calibrate", recording, "--array", array_path, "--effects", effects, "-o", "calibration.yaml")
        answer.give(
            gap_to_mapping(gap, source),
            " ".join(filter(None, (first_sentence(gap), gap.headline, *gap.remarks[:1]))),
            [*law_blocks(gap, is_short=True), *gap_rows.summary_blocks(gap), *used],
            [*_blocks(gap), *used],
            terminal.next_command(*words, is_of_part=True) if effects else "",
        )
    raise click.exceptions.Exit(0 if gap.verdict in ("no_gap", "explained") else 1)


def _diagnose(
    path: Path,
    array: Array,
    without: tuple[str, ...],
    calibration_path: Path | None,
    how: Reading,
    accept: tuple[str, ...],
) -> tuple[Gap, Usage]:
    """Return the diagnosis of a recording, and how many of its samples were used."""
    for name in without:
        effect_named(name)
    calibration = None if calibration_path is None else read_calibration(calibration_path)
    with terminal.showing_progress() as progress:
        source, usage = read_source(path, array, how, terminal.reading(progress), each_once=calibration is None)
        remarks = usage.remarks()
        if calibration is not None:
            if not calibration.is_of(array):
                raise InputError(f"{calibration_path} is the calibration of another array: use the one of this array")
            seen, of_stretches = in_stretches(source)
            source, remarks = calibration.without_effects(seen), (*remarks, *of_stretches)
            source = usage.with_each_reading_once(source)
        going_on = terminal.progress_of(progress, "diagnosing")
        gap = diagnose(source, array, without=without, progress=going_on, accept=accept)
    return replace(gap, remarks=(*remarks, *gap.remarks)), usage


def _read_array(path: Path, recording: Path, place: str | None) -> Array:
    """Return the array, in the field of a place where one is given."""
    array = read_array(path, transforms_in(recording))
    if place is None:
        return array
    if array.field != EARTH_FIELD:
        raise InputError(f"--place and intensity_nT in {path} both tell the field: leave one of them out")
    return replace(array, field=bounds_at(place))
