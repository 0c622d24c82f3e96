"""Cases are tried one after another in several processes, and what is bad is told."""

import ctypes
import json
import os
import pickle
import shutil
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ros_domains import lock_domain

import tam_calibration
from battery import material
from battery.cases import CASES, prepare
from battery.judge import Answer, Bad, Files, is_answer, judge, look
from battery.recipes import RECIPES, Recipe
from battery.run import LIMIT_S, adopt_orphans, run, warm
from battery.surroundings import PLAIN, Ended
from battery.trial import May, Trial

_NEVER_ENDING_S = 6.0
"""After which what runs until it is told to end is told so."""
_IMPORT_S = 1.0
"""What a fresh interpreter takes longer than a fork."""
_CLONE_NEWNS, _CLONE_NEWUSER = 0x20000, 0x10000000


@dataclass(frozen=True)
class Result:
    """What became of a case.

    Parameters
    ----------
    number : int
        Of the case.
    told : str
        What was tried.
    bad : dict of str to str
        Reason by bad class, empty where all is well.
    code : int
        Exit code.
    seconds : float
        That it took.
    """

    number: int
    told: str
    bad: dict[str, str]
    code: int
    seconds: float

    @property
    def family(self) -> str:
        """What it is made like."""
        return CASES[self.number][0]

    @property
    def command(self) -> str:
        """What was called."""
        return RECIPES[CASES[self.number][1]].command


class Battery:
    """The cases of one seed.

    Parameters
    ----------
    seed : int
        Of what is spoiled.
    folder : Path
        For the good inputs and those of the cases; it is there and empty.
    """

    def __init__(self, seed: int, folder: Path) -> None:
        self.seed, self.folder = seed, folder
        self._material = folder / "material"
        self._good: dict[str, tuple[Answer, float]] = {}

    def begin(self) -> None:
        """Import what is needed, and make the good inputs."""
        self._material.mkdir()
        home = self.folder / "home"
        home.mkdir()
        os.chmod(self.folder, 0o755)
        os.environ |= {"HOME": str(home), "ROS_HOME": str(home), "ROS_LOG_DIR": str(home / "logs")}
        os.environ |= {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "OPENBLAS_NUM_THREADS": "1"}
        os.environ |= {"MPLCONFIGDIR": str(home), "PYTHONPATH": str(Path(tam_calibration.__file__).parents[1])}
        warm()
        material.make(self._material)

    def try_case(self, number: int, keeps: bool = False) -> Result:
        """Try one case.

        Parameters
        ----------
        number : int
            Of the case.
        keeps : bool
            Whether its folder stays, to be looked at.
        """
        folder = self.folder / f"case_{number}"
        try:
            trial = prepare(number, self.seed, self._material, folder)
            return self._try(number, trial, folder)
        except Exception as problem:  # of the battery itself: it is told which case it was
            raise RuntimeError(f"case {number} of seed {self.seed}: {CASES[number]}") from problem
        finally:
            if not keeps:
                shutil.rmtree(folder)

    def _try(self, number: int, trial: Trial, folder: Path) -> Result:
        if trial.around.disk_bytes is not None:
            (folder / "disk").mkdir()
            return _in_child(lambda: self._try_on_disk(number, trial, folder))
        return self._try_here(number, trial, folder)

    def _try_on_disk(self, number: int, trial: Trial, folder: Path) -> Result:
        size = trial.around.disk_bytes
        if not _mount_disk(folder / "disk", size or 0):  # not allowed here: files are limited instead
            import resource

            trial = replace(trial, around=replace(trial.around, limits={resource.RLIMIT_FSIZE: size or 0}))
        return self._try_here(number, trial, folder)

    def _try_here(self, number: int, trial: Trial, folder: Path) -> Result:
        good = None
        if trial.may is May.DO_THE_SAME and not trial.recipe.needs_nodes:
            good = self._good_of(RECIPES[CASES[number][1]])
        before = look(folder)
        around, limit_s = trial.around, LIMIT_S
        if around.ended_by is not None and good is not None:
            around = replace(around, moment=around.moment * (good[1] + _IMPORT_S * around.fresh))
        if not trial.recipe.ends:
            around = replace(around, ended_by=signal.SIGINT, moment=_NEVER_ENDING_S)
        ended = run(list(trial.line), folder, around, limit_s)
        good = good if trial.recipe.repeats else None
        tried = replace(trial, around=around)
        bad = self._judge(tried, ended, before, folder, good)
        if around.ended_by is signal.SIGKILL and ended.code == 128 + signal.SIGKILL:
            bad = self._after_a_kill(tried, before, folder, good)
        told = f"tam {' '.join(trial.line)[:300]} [{trial.told}]"
        return Result(number, told, {each.name: why for each, why in bad.items()}, ended.code, ended.seconds)

    def _judge(
        self, trial: Trial, ended: Ended, before: Files, folder: Path, good: tuple[Answer, float] | None
    ) -> dict[Bad, str]:
        after = look(folder)
        answer, bad = _read(folder, trial, ended)
        if trial.around.ended_by is not None and trial.recipe.ends and ended.code and good is not None:
            bad |= _partial(trial, answer, good[0], after, before)
        return judge(trial, ended, before, after, answer, good and good[0]) | bad

    def _after_a_kill(
        self, trial: Trial, before: Files, folder: Path, good: tuple[Answer, float] | None
    ) -> dict[Bad, str]:
        """Judge what SIGKILL left: no output in part, and what else is left is gone when the command has run again."""
        after = look(folder)
        changed = [name for name in before if after.get(name) != before[name]]
        if changed:
            return {Bad.LEFT: f"changed: {', '.join(changed)}"}
        there = [name for name in trial.recipe.writes if name in after]
        if there == list(trial.recipe.writes) and good is not None and not trial.recipe.in_steps:
            answer, bad = _read(folder, trial, Ended(0, False, "", "", 0.0, 0))
            if bad or not answer.is_like(good[0]):
                return bad or {Bad.LEFT: f"in part: {', '.join(there)}"}
        again = replace(trial, around=PLAIN, may=May.DO_THE_SAME)
        if not trial.recipe.in_steps:
            for path in (folder / name for name in trial.recipe.writes):
                if path.is_dir():
                    shutil.rmtree(path)
                elif path.suffix == ".mcap":  # a bag is never replaced
                    path.unlink(missing_ok=True)
        ended = run(list(trial.line), folder, PLAIN, LIMIT_S)
        return self._judge(again, ended, before, folder, good)

    def _good_of(self, recipe: Recipe) -> tuple[Answer, float]:
        """Return what a recipe's own line makes, and the time that it takes."""
        if recipe.name not in self._good:
            folder = self.folder / f"good_{os.getpid()}"
            shutil.copytree(self._material, folder)
            trial = Trial.of(recipe, "good", May.DO_ANYTHING)
            ended = run(list(recipe.line), folder, PLAIN, 10 * LIMIT_S)
            if ended.code and not is_answer(ended):
                raise RuntimeError(f"tam {' '.join(recipe.line)} ends with {ended.code}: {ended.stderr[-2000:]}")
            self._good[recipe.name] = Answer.of(folder, trial, ended), ended.seconds
            shutil.rmtree(folder)
        return self._good[recipe.name]

    def try_all(self, numbers: Sequence[int], jobs: int) -> Iterator[Result]:
        """Try cases in processes, and yield what became of each."""
        todo, todo_writer = os.pipe()
        done, done_writer = os.pipe()
        for number in numbers:
            os.write(todo_writer, number.to_bytes(4, "little"))
        os.close(todo_writer)
        for _ in range(jobs):
            if not os.fork():
                self._work(todo, done_writer)
        os.close(done_writer)
        os.close(todo)
        with os.fdopen(done) as lines:
            for line in lines:
                yield Result(**json.loads(line))
        for _ in range(jobs):
            os.wait()

    def _work(self, todo: int, done: int) -> None:
        """Try cases as long as there are some; never returns."""
        code = 1
        try:
            adopt_orphans()
            domain, _ = (
                lock_domain()
            )  # until this process ends: the nodes of two cases may not meet, nor those of tests
            os.environ["ROS_DOMAIN_ID"] = str(domain)
            while number := os.read(todo, 4):
                result = self.try_case(int.from_bytes(number, "little"))
                os.write(done, (_line(result) + "\n").encode())
            code = 0
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(code)


def _read(folder: Path, trial: Trial, ended: Ended) -> tuple[Answer, dict[Bad, str]]:
    """Return the answer of a command, and what is bad about outputs that cannot be read."""
    try:
        return Answer.of(folder, trial, ended), {}
    except Exception as problem:  # of a reader: what was written is no bag
        return Answer.none(), {Bad.LEFT: f"an output cannot be read: {problem!r}"}


def _partial(trial: Trial, answer: Answer, good: Answer, after: Files, before: Files) -> dict[Bad, str]:
    """Return what is bad about outputs of a command that was ended: none, or all as they would have been."""
    there = [name for name in trial.recipe.writes if name in after]
    if not there or trial.recipe.in_steps:
        return {}
    if len(there) < len(trial.recipe.writes):
        return {Bad.LEFT: f"of a set only {', '.join(there)}"}
    return {} if answer.is_like(good) else {Bad.LEFT: f"in part: {', '.join(there)}"}


def _line(result: Result) -> str:
    """Return a result as one line that a pipe takes at once."""
    told = result.told[:600]
    bad = {name: why[:300] for name, why in result.bad.items()}
    return json.dumps({**vars(result), "told": told, "bad": bad})[:4000]


def _in_child(work: Callable[[], Result]) -> Result:
    """Return what work returns in a fork, whose mounts are its own."""
    reader, writer = os.pipe()
    process = os.fork()
    if not process:
        try:
            adopt_orphans()
            os.write(writer, pickle.dumps(work()))
        except BaseException:
            traceback.print_exc()
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as answer:
        content = answer.read()
    os.waitpid(process, 0)
    return pickle.loads(content)


def _mount_disk(folder: Path, size: int) -> bool:
    """Mount a file system of a size that this process and its children alone see; return whether that is allowed."""
    library = ctypes.CDLL(None)
    user, group = os.geteuid(), os.getegid()
    if library.unshare(_CLONE_NEWNS | (_CLONE_NEWUSER if user else 0)):
        return False
    if user:
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    private = 1 << 18 | 1 << 14  # MS_PRIVATE | MS_REC
    library.mount(b"none", b"/", None, private, None)
    return not library.mount(b"tmpfs", os.fsencode(folder), b"tmpfs", 0, f"size={size}".encode())
