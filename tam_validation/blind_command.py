"""`tam blind`: the check on withheld effects, from making the cases to the score."""

from collections.abc import Callable, Iterator
from concurrent.futures import as_completed
from contextlib import suppress
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tam_calibration.cli.streams import say
from tam_calibration.cli.terminal import (
    JOBS,
    PATH,
    STDOUT,
    Number,
    json_option,
    showing_progress,
    stdout,
    write_together,
)
from tam_calibration.fleet.batch import processes, submit_all
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.results.data_files import write_csv_recording
from tam_validation.blind import KINDS, SETS

if TYPE_CHECKING:
    from tam_validation.blind.case_plan import CasePlan


@click.command()
@click.argument("recording", type=PATH)
@click.option("--array", type=PATH, required=True, help="Array YAML of the recording.")
@click.option("--effect", metavar="NAME", help="Effect to add; without it the names are listed.")
@click.option(
    "--times",
    type=Number(0, 1e6, min_open=True),
    default=1.0,
    show_default=True,
    help="Visible size, in units of the recording's own residual.",
)
@click.option("-o", "--output", type=PATH, required=True, help="CSV to write; the truth goes to .key.json next to it.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
def inject(recording: Path, array: Path, effect: str | None, times: float, output: Path, seed: int) -> None:
    """Put an effect into a real RECORDING, made by the check's own physics and not the library's.

    Its visible size is so many times the residual that the recording leaves by itself. A recorded scalar changes where
    the effect reaches it. Where the effect follows a temperature or a current, the column is made up and added.
    """
    import numpy as np
    from scipy.spatial.transform import Rotation

    from tam_validation.blind.folder import write_json
    from tam_validation.blind.injected import INJECTED
    from tam_validation.blind.injected import inject as put
    from tam_validation.blind.recorded import Recorded

    if effect not in INJECTED:
        raise InputError(f"name an effect to put in with --effect: one of {', '.join(INJECTED)}")
    if output.suffix != ".csv":
        raise InputError(f"{output} must end in .csv")
    real = read_recording(recording)
    described = read_array(array)
    if described.sensor_count != real.sensor_count:
        raise InputError(
            f"{recording} holds {real.sensor_count} sensors, but {array} describes {described.sensor_count}"
        )
    attitude = real.attitude if real.attitude is not None and np.isfinite(real.attitude).all() else None
    to_world = None if attitude is None else Rotation.from_quat(attitude).as_matrix()
    recorded = Recorded(real.time_s, real.readings_T, real.scalar_T, to_world, described.positions_m)
    made = put(recorded, effect, times, seed)
    with write_together({"data": output, "key": output.with_suffix(".key.json")}, [recording, array]) as beside:
        write_csv_recording(beside["data"], replace(real, **made.columns))
        write_json(beside["key"], {"recording": recording.name, **made.key})
    visible_nT, own_nT = made.key["visible_nT"], made.key["own_residual_nT"]
    say(
        f"{effect} of {visible_nT:.3g} nT in {output}, {times:g} times the {own_nT:.3g} nT that the recording leaves "
        f"by itself; the truth is in {output.with_suffix('.key.json')}"
    )


_PRELOADED = ("tam_calibration.cli.diagnose", "tam_validation.blind.case")
"""What tasks load: loaded once, before the processes are forked."""

Task = TypeVar("Task")
Result = TypeVar("Result")

_jobs_option = click.option("--jobs", type=JOBS, default=2, show_default=True, help="Number of processes.")
_keys_option = click.option("--keys", "keys_path", type=PATH, help="The sealed keys.  [default: DIR/keys.json]")


@click.group()
def command() -> None:
    """Check the diagnosis on recordings whose cause is known but withheld."""


command.add_command(inject)


@command.command()
@click.argument("folder", metavar="OUT", type=PATH)
@click.option("--cases", type=click.IntRange(1, 9999), default=400, show_default=True)
@click.option("--seed", type=click.IntRange(min=0), required=True, help="Use one that nothing was tuned on.")
@click.option("--kinds", type=click.Choice(KINDS), multiple=True, default=KINDS, show_default=True)
@click.option(
    "--outside",
    type=click.Choice(SETS),
    default=SETS[0],
    show_default=True,
    help="Set of causes outside the library to draw from, for the kinds outside and mixed.",
)
@_jobs_option
def make(folder: Path, cases: int, seed: int, kinds: tuple[str, ...], outside: str, jobs: int) -> None:
    """Make recordings in OUT, with their sealed keys in keys.json and what commits to those in commitments.json.

    A case is left out where no recording shows its causes apart.
    """
    from tam_validation.blind.case_plan import plan_cases
    from tam_validation.blind.folder import COMMITMENTS, KEYS, case_name, seal, write_json

    if folder.exists() and any(folder.iterdir()):
        raise InputError(f"{folder} is not empty: name a new folder, so that no case is mixed with an older one")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with suppress(FileNotFoundError):
        folder.rmdir()
    with write_together({"cases": folder}, []) as beside:
        plans = plan_cases(kinds, cases, seed, outside)
        tasks = [(beside["cases"], plan, seed, number) for number, plan in enumerate(plans, start=1)]
        keys, commitments, left_out = {}, {}, {}
        for number, made in _in_processes("making cases", _make_one, tasks, jobs):
            if isinstance(made, str):
                left_out[case_name(number)] = made
            else:
                keys[case_name(number)], commitments[case_name(number)] = seal(made)
        if not keys:
            raise Refused(f"no case can be made: {left_out[case_name(1)]}")
        write_json(beside["cases"] / KEYS, dict(sorted(keys.items())))
        write_json(beside["cases"] / COMMITMENTS, dict(sorted(commitments.items())))
    for name, reason in sorted(left_out.items()):
        say(f"{name} is left out: {reason}")
    say(f"{len(keys)} cases in {folder}, their keys in {folder / KEYS}: keep those apart until the score")


def _make_one(task: tuple[Path, "CasePlan", int, int]) -> tuple[int, dict[str, Any] | str]:
    """Write a case, and return its number and key; or why there is none."""
    from tam_validation.blind.case import make_case
    from tam_validation.blind.folder import case_name, write_case

    folder, plan, seed, number = task
    try:
        case = make_case(plan, seed, number)
    except Refused as reason:
        return number, str(reason)
    write_case(folder / case_name(number), case)
    return number, case.key


@command.command()
@click.argument("folder", metavar="DIR", type=PATH)
@_jobs_option
@click.option("--without-effect", is_flag=True, help="Open the keys, and leave out each case's true effect.")
@_keys_option
def answer(folder: Path, jobs: int, without_effect: bool, keys_path: Path | None) -> None:
    """Diagnose every case in DIR from data.csv and spec.yaml alone; each answer goes to answer.json beside them.

    With --without-effect it goes to answer_without.json, and only single effects are tried.
    """
    from tam_validation.blind.folder import TIMES, case_folders, read_keys, write_json

    tasks: list[tuple[Path, str]] = [(case, "") for case in case_folders(folder)]
    if without_effect:
        keys = read_keys(folder, keys_path)
        tasks = [
            (case, keys[case.name]["effects"][0]["effect"]) for case, _ in tasks if keys[case.name]["kind"] == "single"
        ]
    times = dict(_in_processes("diagnosing", _answer_one, tasks, jobs))
    if not without_effect:
        write_json(folder / TIMES, dict(sorted(times.items())))
    say(f"{len(times)} answers in {folder}")


def _answer_one(task: tuple[Path, str]) -> tuple[str, float]:
    """Run tam diagnose on a case, and return its name and the processor time."""
    from time import process_time

    from tam_calibration.cli.main import main
    from tam_validation.blind.folder import write_json

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
@_keys_option
@click.option("--failures", is_flag=True, help="List the cases that went wrong, key against answer, one in a line.")
@json_option
def score(folder: Path, keys_path: Path | None, failures: bool, json_path: Path | None) -> None:
    """Open the keys of DIR, compare them with their commitments, and count the right answers.

    A case without an answer counts as one that was answered wrongly.
    """
    from tam_calibration.effects.library import installed_effects
    from tam_calibration.files.text_files import to_json
    from tam_validation.blind.folder import COMMITMENTS, KEYS, TIMES, read_keys, read_outcomes, read_times
    from tam_validation.blind.outcome import Outcome
    from tam_validation.blind.score import Score
    from tam_validation.blind.score_table import print_score, score_to_mapping

    keys = read_keys(folder, keys_path)
    given, without = (
        read_outcomes(folder, keys, name, installed_effects()) for name in ("answer.json", "answer_without.json")
    )
    if not given:
        raise Refused(f"no case in {folder} has an answer: run tam blind answer {folder} first")
    missing = keys.keys() - {one.name for one in given}
    if missing:
        say(f"warning: {len(missing)} of {len(keys)} cases have no answer and count as wrong", err=True)
    result = Score([*given, *(Outcome(name, keys[name], {"verdict": "error"}) for name in sorted(missing))], without)
    times = read_times(folder)
    inputs = [keys_path or folder / KEYS, folder / COMMITMENTS, folder / TIMES, *(folder / name for name in keys)]
    content = to_json(score_to_mapping(result, times))
    with write_together({"json": None if json_path == STDOUT else json_path}, inputs) as beside:
        if "json" in beside:
            beside["json"].write_text(content + "\n", encoding="utf-8")
    if json_path == STDOUT:
        say(content)
    elif failures:
        for outcome in result.failures:
            say(outcome.line)
    else:
        print_score(stdout(), result, times)


def _in_processes(description: str, work: Callable[[Task], Result], tasks: list[Task], jobs: int) -> Iterator[Result]:
    """Do the tasks in processes of one thread each, and return the results as they come."""
    context = get_context("forkserver")
    context.set_forkserver_preload(list(_PRELOADED))
    with processes(jobs, context) as pool, showing_progress() as progress:
        done = as_completed(submit_all(pool, work, tasks))
        for future in progress.track(done, total=len(tasks), description=description):
            yield future.result()
