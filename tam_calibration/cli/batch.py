"""`tam batch`: many recordings through calibration, diagnosis and correction."""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tam_calibration.cli import terminal
from tam_calibration.fleet import summary
from tam_calibration.fleet.task import Result
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.libraries import require
from tam_calibration.recordings.bag_storages import is_bag
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.report.blocks import Block, Table, Text

if TYPE_CHECKING:
    from tam_calibration.fleet.batch import Run


def _blocks(results: Sequence[Result]) -> list[Block]:
    """Return counts by platform, the drifts that stand out most, and which platforms have none."""
    blocks: list[Block] = [Table(summary.COUNTS_HEADER, summary.count_rows(results), "What was found")]
    blocks += [Text(f"Law of the gap: {words}.") for words in summary.law_points(results)[: terminal.FEW]]
    if drifts := summary.largest(summary.all_drifts(results)):
        rows = [summary.drift_row(found)[:-1] for found in drifts]
        blocks.append(Table(summary.DRIFT_HEADER[:-1], rows, "Largest drift of each kind, ± standard errors"))
    missions = summary.all_missions(results)
    return [*blocks, *(Text(f"{each.platform}: {each.no_drift}") for each in missions if each.no_drift)]


def _answer(results: Sequence[Result], points: Sequence[str]) -> str:
    settled = f"{sum(result.is_settled for result in results)} of {len(results)} recordings are settled"
    return f"{settled}; the first of the others: {points[0]}" if points else f"{settled}."


@click.command()
@click.argument("recordings", nargs=-1, required=True)
@terminal.array_option
@terminal.path_option(
    "--calibration", "Calibration YAML to correct with; its effects are removed first. By default each recording's own."
)
@terminal.effects_option
@click.option("-o", "--output", type=terminal.PATH, required=True, help="Folder of the results.")
@click.option("--jobs", type=terminal.JOBS, help="Number of processes on this machine; by default one for each core.")
@click.option("--scheduler", help="Address of a Dask scheduler, such as tcp://host:8786, whose workers do the work.")
@terminal.reading_options
@terminal.answer_options
def command(
    recordings: tuple[str, ...],
    array_path: Path,
    calibration_path: Path | None,
    effects: tuple[str, ...],
    output: Path,
    jobs: int | None,
    scheduler: str | None,
    how: Reading,
    detail: terminal.Detail,
) -> None:
    """Calibrate, diagnose and correct many RECORDINGS: files, folders, or patterns such as 'missions/**/*.mcap'.

    Run again, also after a kill, it does what is missing, has failed or has changed. The folder of a recording names
    its platform. Exits 0 when all is done and no gap is open, 1 when something was refused,
    failed or stays unexplained, 2 on bad input.
    """
    require("report", "the summary of a batch")
    from tam_calibration.fleet.batch import find_recordings, require_separate_folder, run_batch
    from tam_calibration.fleet.task import read_options

    options = read_options(array_path, calibration_path, how, effects)
    paths = find_recordings(recordings, without=output)
    inputs = [*paths, *(path for path in (array_path, calibration_path) if path is not None)]
    require_separate_folder(output, inputs)
    run = _runner(paths, jobs, scheduler)
    with terminal.showing_progress() as progress:
        results = run_batch(paths, output, options, run, terminal.working(progress, "recordings"))
    _print(results, output, detail)
    raise click.exceptions.Exit(0 if all(result.is_settled for result in results) else 1)


def _runner(paths: Sequence[Path], jobs: int | None, scheduler: str | None) -> "Run":
    """Return what does the tasks: processes of this machine, or the workers of a cluster."""
    from tam_calibration.fleet.batch import run_here, run_on_cluster

    if scheduler is not None:
        if jobs is not None:
            raise InputError("give either --jobs, for this machine, or --scheduler, for a cluster")
        return partial(run_on_cluster, scheduler=scheduler)
    if any(is_bag(path) for path in paths):
        require("bags", "reading bags")
    return partial(run_here, jobs=jobs or len(os.sched_getaffinity(0)))


def _print(results: Sequence[Result], output: Path, detail: terminal.Detail) -> None:
    blocks, points = _blocks(results), summary.open_points(results)
    terminal.print_answer(
        _answer(results, points),
        [*map(Text, points[1 : terminal.FEW]), *blocks],
        [*blocks, *map(Text, points)],
        detail,
        (output / name for name in summary.SUMMARIES),
    )
