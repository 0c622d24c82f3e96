"""`tam batch`: many recordings through calibration, diagnosis and correction."""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click

from tam_calibration.cli.terminal import (
    JOBS,
    PATH,
    print_blocks,
    reading_options,
    say_written,
    showing_progress,
)
from tam_calibration.fleet.missions import all_drifts, all_missions
from tam_calibration.fleet.rows import COUNTS_HEADER, DRIFT_HEADER, count_rows, drift_row, largest, open_points
from tam_calibration.fleet.task import Result
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.extras import require
from tam_calibration.recordings.bag_storages import is_bag
from tam_calibration.recordings.reading import Reading
from tam_calibration.report.blocks import Block, Table, Text


def _blocks(results: Sequence[Result]) -> list[Block]:
    """Return counts by platform, the drift of each kind of parameter that stands out most, and what is open."""
    blocks: list[Block] = [Table(COUNTS_HEADER, count_rows(results), "What was found")]
    drifts = [drift_row(found)[:-1] for found in largest(all_drifts(results))]
    if drifts:
        blocks.append(Table(DRIFT_HEADER[:-1], drifts, "Largest drift of each kind, ± standard errors"))
    without = [f"{each.platform}: {each.no_drift}" for each in all_missions(results) if each.no_drift]
    return blocks + [Text(words) for words in (*without, *open_points(results))]


@click.command()
@click.argument("recordings", nargs=-1, required=True)
@click.option("--array", "array_path", type=PATH, required=True, help="Array YAML: where the sensors sit, their noise.")
@click.option(
    "--calibration",
    "calibration_path",
    type=PATH,
    help="Calibration YAML to correct with, its effects taken off first; by default each recording's own.",
)
@click.option("--out", type=PATH, required=True, help="Folder of the results.")
@click.option("--jobs", type=JOBS, help="Processes of this machine; by default one for each core.")
@click.option("--scheduler", help="Address of a Dask scheduler, such as tcp://host:8786, whose workers do the work.")
@reading_options
@click.pass_context
def command(
    ctx: click.Context,
    recordings: tuple[str, ...],
    array_path: Path,
    calibration_path: Path | None,
    out: Path,
    jobs: int | None,
    scheduler: str | None,
    how: Reading,
) -> None:
    """Calibrate, diagnose and correct many RECORDINGS, or those that patterns find, such as 'missions/**/*.mcap'.

    Called again, also after it was killed, it does what is not done yet, has failed or has changed. The folder that a
    recording lies in names its platform. Exits 0 when all is done and no gap is open, 1 when something was refused,
    failed or stays unexplained, 2 on bad input.
    """
    require("report", "the summary of a batch")
    from tam_calibration.fleet.batch import find_recordings, require_separate_folder, run_batch
    from tam_calibration.fleet.processes import run_here, run_on_cluster
    from tam_calibration.fleet.summary import SUMMARIES
    from tam_calibration.fleet.task import read_options

    if jobs is not None and scheduler is not None:
        raise InputError("give either --jobs, for this machine, or --scheduler, for a cluster")
    options = read_options(array_path, calibration_path, how)
    paths = find_recordings(recordings, without=out)
    require_separate_folder(out, [*paths, *(path for path in (array_path, calibration_path) if path is not None)])
    if scheduler is None:
        if any(is_bag(path) for path in paths):
            require("bags", "reading bags")
        run = partial(run_here, jobs=jobs or len(os.sched_getaffinity(0)))
    else:
        run = partial(run_on_cluster, scheduler=scheduler)
    with showing_progress() as progress:
        task = progress.add_task("recordings", total=len(paths))
        results = run_batch(
            paths, out, options, run, lambda done, total: progress.update(task, completed=done, total=total)
        )
    print_blocks(_blocks(results))
    say_written(out / name for name in SUMMARIES)
    ctx.exit(0 if all(result.is_settled for result in results) else 1)
