"""`tam batch`: many recordings through calibration, diagnosis and correction."""

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import click
from rich.console import Console
from rich.table import Table

from tam_calibration.cli.terminal import JOBS, PATH, showing_progress, stdout, tolerance_option
from tam_calibration.files.recording_file import is_bag
from tam_calibration.fleet.missions import all_drifts
from tam_calibration.fleet.rows import COUNTS_HEADER, DRIFT_HEADER, count_rows, drift_row, largest, open_points
from tam_calibration.fleet.task_result import Result
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.extras import require


def _print_batch(console: Console, results: Sequence[Result]) -> None:
    """Print counts by platform, the drift of each kind of parameter that stands out most, and what is open."""
    console.print(_table("What was found", COUNTS_HEADER, count_rows(results)))
    drifts = [drift_row(found)[:-1] for found in largest(all_drifts(results))]
    if drifts:
        console.print(_table("Largest drift of each kind, ± standard errors", DRIFT_HEADER[:-1], drifts))
    for point in open_points(results):
        console.print(point)


def _table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(header[0], title=title)
    for name in header[1:]:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*row)
    return table


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
@tolerance_option
@click.pass_context
def command(
    ctx: click.Context,
    recordings: tuple[str, ...],
    array_path: Path,
    calibration_path: Path | None,
    out: Path,
    jobs: int | None,
    scheduler: str | None,
    tolerance_s: float,
) -> None:
    """Calibrate, diagnose and correct many RECORDINGS: bags and CSV files, or patterns such as 'missions/**/*.mcap'.

    Called again, also after it was killed, it does what is not done yet, has failed or has changed. The folder that a
    recording lies in names its platform. Exits 0 when all is done and no gap is open, 1 when something was refused,
    failed or stays unexplained, 2 on bad input.
    """
    require("report", "the summary of a batch")
    from tam_calibration.fleet.batch import find_recordings, require_separate_folder, run_batch
    from tam_calibration.fleet.execution import run_here, run_on_cluster
    from tam_calibration.fleet.summary import SUMMARIES
    from tam_calibration.fleet.task import read_options

    if jobs is not None and scheduler is not None:
        raise InputError("give either --jobs, for this machine, or --scheduler, for a cluster")
    options = read_options(array_path, calibration_path, tolerance_s)
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
    _print_batch(stdout(), results)
    for name in SUMMARIES:
        click.echo(f"written: {out / name}")
    ctx.exit(0 if all(result.is_settled for result in results) else 1)
