"""`tam blind`: the check on withheld effects, from making the cases to the score."""

import os
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tam_calibration.cli.terminal import showing_progress
from tam_calibration.problems import InputError

if TYPE_CHECKING:
    from tam_calibration.blind.case import Plan

Task = TypeVar("Task")
Result = TypeVar("Result")

KINDS = ("single", "pair", "outside", "clean", "withheld", "short")


@click.group()
def command() -> None:
    """Check the diagnosis on recordings whose cause is known but withheld."""


@command.command()
@click.argument("folder", metavar="OUT", type=click.Path(path_type=Path))
@click.option("--cases", type=click.IntRange(min=1), default=400, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), required=True, help="Never one that anything was tuned on.")
@click.option("--kinds", type=click.Choice(KINDS), multiple=True, default=KINDS, show_default=True)
@click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Processes.")
def make(folder: Path, cases: int, seed: int, kinds: tuple[str, ...], jobs: int) -> None:
    """Make recordings in OUT, with a sealed key of each in OUT/keys.json and what commits to it beside."""
    from tam_calibration.blind.case import plan_cases
    from tam_calibration.blind.folder import case_name, write_json
    from tam_calibration.blind.seal import seal

    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty: name a new folder, so that no case is mixed with an older one")
    folder.mkdir(parents=True, exist_ok=True)
    tasks = [(folder, plan, seed, number) for number, plan in enumerate(plan_cases(kinds, cases, seed), start=1)]
    keys, commitments = {}, {}
    for number, key in _in_processes("making cases", _make_one, tasks, jobs):
        keys[case_name(number)], commitments[case_name(number)] = seal(key)
    write_json(folder / "keys.json", dict(sorted(keys.items())))
    write_json(folder / "commitments.json", dict(sorted(commitments.items())))
    click.echo(f"{cases} cases in {folder}, their keys in {folder / 'keys.json'}: keep those apart until the score")


def _make_one(task: tuple[Path, "Plan", int, int]) -> tuple[int, dict[str, Any]]:
    from tam_calibration.blind.case import make_case
    from tam_calibration.blind.folder import case_name, write_case

    folder, plan, seed, number = task
    case = make_case(plan, seed, number)
    write_case(folder / case_name(number), case)
    return number, case.key


def _in_processes(description: str, work: Callable[[Task], Result], tasks: list[Task], jobs: int) -> Iterator[Result]:
    """Do the tasks in processes of one thread each, in any order."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with get_context("spawn").Pool(jobs) as pool, showing_progress() as progress:
        yield from progress.track(pool.imap_unordered(work, tasks), total=len(tasks), description=description)
