"""`tam inspect`: what a recording contains, what is odd about it, and what would be taken of it for what."""

from pathlib import Path

import click

from tam_calibration.cli.terminal import MOST_ROWS, PATH, Answer, answering, next_command, reading, showing_progress
from tam_calibration.recordings import read_array, transforms_in
from tam_calibration.recordings.inspection import Inspection, inspect, inspection_to_mapping
from tam_calibration.report.blocks import Block, Points, Table, Text
from tam_calibration.report.inspection_report import HEADER, headline, rows_of

_CHANNELS = 12
"""Channels of a topic that are printed in addition to those taken."""


@click.command()
@click.argument("recording", type=PATH, nargs=-1, required=True)
@click.option("--array", "array_path", type=PATH, help="Array YAML: its number of sensors helps to choose.")
@click.option("--write-map", "map_path", type=PATH, help="Write the choice, or the best guess, as a map to edit.")
@click.option("--report", type=PATH, help="Write an HTML page that draws every channel over time.")
@answering
def command(
    recording: tuple[Path, ...], array_path: Path | None, map_path: Path | None, report: Path | None, answer: Answer
) -> None:
    """Show what RECORDING contains, what is odd, and what is taken as sensors and channels.

    Several files make one recording, such as one file for each sensor. Exits 0 when a choice can be made, 1 when it is
    ambiguous or not enough (it says what to add), 2 on bad input.
    """
    with answer.files([*recording, array_path], map=map_path, report=report) as places:
        with showing_progress() as progress:
            array = None if array_path is None else read_array(array_path, transforms_in(recording[0]))
            found = inspect(recording, array, reading(progress))
        if "map" in places:
            places["map"].write_text(found.map_yaml(), encoding="utf-8")
        if "report" in places:
            from tam_calibration.report.inspection_report import write_inspection_report

            write_inspection_report(places["report"], found)
        words: tuple[object, ...] = ("inspect", *recording, "--write-map", "map.yaml")
        if found.is_certain and (map_path or len(recording) == 1):
            words = ("calibrate", recording[0], "--array", array_path or "array.yaml", "-o", "calibration.yaml")
            words += ("--map", map_path) if map_path else ()
        answer.give(inspection_to_mapping(found), headline(found), _blocks(found), advice=next_command(*words))
    raise click.exceptions.Exit(0 if found.is_certain else 1)


def _blocks(found: Inspection) -> list[Block]:
    blocks: list[Block] = [Table(HEADER, list(rows_of(found, _CHANNELS)), numeric=False)]
    more = [f"… and {len(found.oddities) - MOST_ROWS} more: --json has all"] if len(found.oddities) > MOST_ROWS else []
    for title, clauses in (
        ("Taken:", found.reasons),
        ("Odd:", (*found.oddities[:MOST_ROWS], *more)),
        ("Note:", found.remarks),
        ("To settle in a map:", found.doubts),
    ):
        if clauses:
            blocks += [Text(title), Points(clauses)]
    return [*blocks, Text("A choice can be made.")] if found.is_certain else blocks
