"""`tam blind`: the check on withheld effects, from making the cases to the score."""

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tam_calibration.blind import KINDS
from tam_calibration.cli.blind_inject import inject
from tam_calibration.cli.terminal import PATH, showing_progress, stdout, write_together
from tam_calibration.exceptions import InputError, Refused

if TYPE_CHECKING:
    from tam_calibration.blind.plan import Plan

Task = TypeVar("Task")
Result = TypeVar("Result")

jobs_option = click.option("--jobs", type=click.IntRange(min=1), default=2, show_default=True, help="Processes.")
keys_option = click.option("--keys", "keys_path", type=PATH, help="The sealed keys.  [default: DIR/keys.json]")


@click.group()
def command() -> None:
    """Check the diagnosis on recordings whose cause is known but withheld."""


command.add_command(inject)


@command.command()
@click.argument("folder", metavar="OUT", type=PATH)
@click.option("--cases", type=click.IntRange(min=1), default=400, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), required=True, help="Never one that anything was tuned on.")
@click.option("--kinds", type=click.Choice(KINDS), multiple=True, default=KINDS, show_default=True)
@click.option(
    "--outside",
    type=click.Choice(("open", "sealed", "both")),
    default="open",
    show_default=True,
    help="Causes outside the library: the half to tune on, or the one to judge by.",
)
@jobs_option
def make(folder: Path, cases: int, seed: int, kinds: tuple[str, ...], outside: str, jobs: int) -> None:
    """Make recordings in OUT, with their sealed keys in keys.json and what commits to those in commitments.json."""
    from tam_calibration.blind.folder import COMMITMENTS, KEYS, case_name, write_json
    from tam_calibration.blind.plan import plan_cases
    from tam_calibration.blind.seal import seal

    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty: name a new folder, so that no case is mixed with an older one")
    folder.mkdir(parents=True, exist_ok=True)
    plans = plan_cases(kinds, cases, seed, outside)
    tasks = [(folder, plan, seed, number) for number, plan in enumerate(plans, start=1)]
    keys, commitments = {}, {}
    for number, key in _in_processes("making cases", _make_one, tasks, jobs):
        keys[case_name(number)], commitments[case_name(number)] = seal(key)
    write_json(folder / KEYS, dict(sorted(keys.items())))
    write_json(folder / COMMITMENTS, dict(sorted(commitments.items())))
    click.echo(f"{cases} cases in {folder}, their keys in {folder / KEYS}: keep those apart until the score")


def _make_one(task: tuple[Path, "Plan", int, int]) -> tuple[int, dict[str, Any]]:
    from tam_calibration.blind.case import make_case
    from tam_calibration.blind.folder import case_name, write_case

    folder, plan, seed, number = task
    case = make_case(plan, seed, number)
    write_case(folder / case_name(number), case)
    return number, case.key


@command.command()
@click.argument("folder", metavar="DIR", type=PATH)
@jobs_option
@click.option("--without-effect", is_flag=True, help="Open the keys, and leave each case's true effect out.")
@keys_option
def answer(folder: Path, jobs: int, without_effect: bool, keys_path: Path | None) -> None:
    """Diagnose every case in DIR from data.csv and spec.yaml alone; each answer goes to answer.json beside them.

    With --without-effect it goes to answer_without.json, and only single effects are tried.
    """
    from tam_calibration.blind.folder import TIMES, case_folders, read_keys, write_json

    tasks: list[tuple[Path, str]] = [(case, "") for case in case_folders(folder)]
    if without_effect:
        keys = read_keys(folder, keys_path)
        tasks = [(case, keys[case.name]["effects"][0]["effect"]) for case, _ in tasks if _is_single(keys[case.name])]
    times = dict(_in_processes("diagnosing", _answer_one, tasks, jobs))
    if not without_effect:
        write_json(folder / TIMES, dict(sorted(times.items())))
    click.echo(f"{len(times)} answers in {folder}")


def _is_single(key: dict[str, Any]) -> bool:
    return bool(key["kind"] == "single")


def _answer_one(task: tuple[Path, str]) -> tuple[str, float]:
    """Run tam diagnose on a case, and return its name and the processor time."""
    from time import process_time

    from tam_calibration.blind.folder import write_json
    from tam_calibration.cli.main import main

    case, without = task
    path = case / ("answer_without.json" if without else "answer.json")
    path.unlink(missing_ok=True)
    arguments = ["diagnose", str(case / "data.csv"), "--array", str(case / "spec.yaml"), "--json", str(path)]
    began = process_time()
    why = _run_quietly(main, arguments + (["--without", without] if without else []))
    if not path.exists():
        write_json(path, {"verdict": "error", "why": why})
    return case.name, process_time() - began


def _run_quietly(main: click.Command, arguments: list[str]) -> str:
    """Run a command in this process as a shell would, and return what it said last."""
    import traceback
    from contextlib import redirect_stderr, redirect_stdout
    from io import StringIO

    said = StringIO()
    with redirect_stdout(StringIO()), redirect_stderr(said):
        try:
            main.main(arguments, prog_name="tam", standalone_mode=False)
        except click.ClickException as problem:
            said.write(problem.format_message())
        except Exception:  # a defect of a command is an answer, too: no other case may be lost by it
            said.write(traceback.format_exc())
    return (said.getvalue().strip().splitlines() or ["there is no answer"])[-1]


@command.command()
@click.argument("folder", metavar="DIR", type=PATH)
@keys_option
@click.option("--json", "json_path", type=PATH, help="Write the figures as JSON.")
@click.option("--report", type=PATH, help="Write an HTML page.")
@click.option("--failures", is_flag=True, help="List the cases that went wrong, key against answer, one in a line.")
def score(folder: Path, keys_path: Path | None, json_path: Path | None, report: Path | None, failures: bool) -> None:
    """Open the keys of DIR, hold them against their commitments, and say how many answers are right."""
    from tam_calibration.blind.folder import TIMES, read_json, read_keys, read_outcomes
    from tam_calibration.blind.score import Score
    from tam_calibration.cli.blind_table import print_score, score_to_mapping
    from tam_calibration.files.json_text import to_json

    keys = read_keys(folder, keys_path)
    result = Score(read_outcomes(folder, keys, "answer.json"), read_outcomes(folder, keys, "answer_without.json"))
    if not result.outcomes:
        raise Refused(f"no case in {folder} has an answer: run tam blind answer {folder} first")
    times = read_json(folder / TIMES) if (folder / TIMES).exists() else {}
    with write_together({"json": json_path, "report": report}, []) as beside:
        if "json" in beside:
            beside["json"].write_text(to_json(score_to_mapping(result, times)) + "\n", encoding="utf-8")
        if "report" in beside:
            from tam_calibration.cli.blind_page import write_page

            write_page(beside["report"], result, folder.name)
    if failures:
        for outcome in result.failures:
            click.echo(outcome.line)
    else:
        print_score(stdout(), result, times)


def _in_processes(description: str, work: Callable[[Task], Result], tasks: list[Task], jobs: int) -> Iterator[Result]:
    """Do the tasks in processes of one thread each, and return the results as they come."""
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    with ProcessPoolExecutor(jobs, get_context("spawn")) as pool, showing_progress() as progress:
        done = as_completed([pool.submit(work, task) for task in tasks])
        for future in progress.track(done, total=len(tasks), description=description):
            yield future.result()
