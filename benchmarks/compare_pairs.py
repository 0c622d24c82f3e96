"""The check of `tam compare` on sealed pairs: simulations from MuJoCo beside recordings from another physics.

Run, one after another, with seeds from 100 on to judge, as 1 to 99 are for tuning::

    python benchmarks/compare_pairs.py make OUT --seed SEED
    python benchmarks/compare_pairs.py judge OUT
    python benchmarks/compare_pairs.py score OUT

``make`` writes OUT/pair_001/simulation.csv, recording.csv and array.yaml, and the truth of all pairs to OUT/key.json,
whose SHA-256 it prints and writes to OUT/key.sha256. ``judge`` compares each pair from its three files alone.
``score`` opens the key, holds it against its seal, compares the recordings with the simulations that their maker
mended, and prints the figures beside what is asked, then each pair that went wrong. A stage that is broken off goes on
where it was when it is called again. The extra ``compare`` holds MuJoCo.
"""

import os
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import click
from rich.console import Console
from rich.progress import track
from rich.table import Table

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.append(str(Path(__file__).parents[1] / "examples"))

from pairs.folder import (
    ANSWERS,
    begin,
    key_path,
    mended_path,
    open_key,
    pair_name,
    pair_names,
    seal,
    write_pair,
)
from pairs.judging import answer, compare_mended, truth_path
from pairs.making import make_pair
from pairs.outcome import PairOutcome
from pairs.plan import PairPlan, plan_pairs
from pairs.score import failures, rows
from pairs.world import make_world_pair

from tam_calibration.fleet.batch import processes, submit_all
from tam_calibration.model.exceptions import InputError, Refused
from tam_validation.blind.folder import read_json

Task = TypeVar("Task")

PATH = click.Path(path_type=Path)
FOLDER = click.argument("folder", metavar="OUT", type=PATH)
JOBS = click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Processes.")


@click.group(help=__doc__)
def main() -> None:
    """Make, judge and score pairs."""


@main.command()
@FOLDER
@click.option("--seed", type=click.IntRange(min=0), required=True)
@click.option("--pairs", "count", type=click.IntRange(1), default=200, show_default=True, help="Without the mistakes.")
@click.option("--world", type=PATH, help="Python file of another world, for some recordings more.")
@JOBS
def make(folder: Path, seed: int, count: int, world: Path | None, jobs: int) -> None:
    """Make pairs in OUT, and seal their key."""
    if world is None:
        click.echo("no other world is given with --world: its pairs are left out")
    begin(folder, {"seed": seed, "pairs": count, "world": None if world is None else world.name})
    plans = dict(enumerate(plan_pairs(count, seed, world is not None), start=1))
    left = [(number, plan) for number, plan in plans.items() if not key_path(folder, pair_name(number)).exists()]
    in_processes("making pairs", partial(make_one, folder, world, seed), left, jobs)
    digest = seal(folder, [pair_name(number) for number in plans])
    click.echo(f"{len(plans)} pairs in {folder}; SHA-256 of their key: {digest}")


def make_one(folder: Path, world: Path | None, seed: int, task: tuple[int, PairPlan]) -> None:
    """Make one pair."""
    number, plan = task
    if plan.kind == "world":
        assert world is not None
        pair = make_world_pair(plan, world, seed, number)
    else:
        pair = make_pair(plan, seed, number)
    write_pair(folder, pair_name(number), pair)


@main.command()
@FOLDER
@JOBS
def judge(folder: Path, jobs: int) -> None:
    """Compare every pair of OUT that has no answer yet."""
    left = [name for name in pair_names(folder) if not (folder / ANSWERS / f"{name}.json").exists()]
    in_processes("comparing", partial(answer, folder), left, jobs)
    click.echo(f"{len(left)} answers more in {folder / ANSWERS}")


@main.command()
@FOLDER
@JOBS
def score(folder: Path, jobs: int) -> None:
    """Open the key of OUT, and print the figures."""
    answered = [name for name in pair_names(folder) if (folder / ANSWERS / f"{name}.json").exists()]
    mended = [name for name in answered if mended_path(folder, name).exists()]
    left = [name for name in mended if not truth_path(folder, name).exists()]
    in_processes("comparing what was mended", partial(compare_mended, folder), left, jobs)
    keys = open_key(folder)
    outcomes = [
        PairOutcome(
            name,
            keys[name],
            read_json(folder / ANSWERS / f"{name}.json"),
            read_json(truth_path(folder, name)) if name in mended else None,
        )
        for name in answered
    ]
    table = Table("figure", "n", "value", "asked", "met", title=f"{len(outcomes)} of {len(keys)} pairs")
    for row in rows(outcomes):
        met = "" if row.is_met is None or not row.count else "yes" if row.is_met else "NO"
        table.add_row(row.name, str(row.count), row.value if row.count else "–", row.asked, met)
    Console(width=120).print(table)
    for one in failures(outcomes):
        click.echo(one.line)


def in_processes(description: str, work: Callable[[Task], None], tasks: Iterable[Task], jobs: int) -> None:
    """Do tasks in processes of one thread each."""
    listed = list(tasks)
    with processes(jobs, get_context("spawn")) as pool:
        done = as_completed(submit_all(pool, work, listed))
        for future in track(done, description, total=len(listed), console=Console(stderr=True), transient=True):
            future.result()


if __name__ == "__main__":
    try:
        main(standalone_mode=False)
    except click.ClickException as problem:
        problem.show()
        sys.exit(problem.exit_code)
    except (InputError, Refused) as problem:
        sys.exit(f"{problem}")
