"""A batch of the recordings that patterns name: what is done already is kept, the rest is done, all is summed up."""

import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from glob import glob, has_magic
from os.path import realpath
from pathlib import Path

from tam_calibration.files.text_files import hold, remove_left_over
from tam_calibration.fleet.summary import SUMMARIES, write_summaries
from tam_calibration.fleet.task import Options, Result, Task, read_result
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.recordings.bag_storages import STORAGES
from tam_calibration.results.overwriting import require_separate

_SUFFIXES = (".csv", ".zstd", *(storage.suffix for storage in STORAGES.values()))
_METADATA = "metadata.yaml"
_LOCK, _RECORDINGS = ".lock", "recordings"


def find_recordings(patterns: Iterable[str], without: Path) -> list[Path]:
    """Return the recordings that patterns name, each once, sorted by their absolute paths.

    A file of a bag's folder stands for the bag. A pattern such as ``missions/**`` finds bags and files that end in
    .csv, .mcap, .db3 or .bag, and those that end as the pattern does; a name without ``*``, ``?`` or ``[`` is taken
    as it is.

    Parameters
    ----------
    patterns : iterable of str
        As of a shell, where ``**`` stands for any number of folders.
    without : Path
        Folder in which nothing is looked for.

    Raises
    ------
    InputError
        When a pattern finds nothing.
    """
    without = Path(realpath(without))
    found: set[Path] = set()
    for pattern in patterns:
        here = {path for path in _matches(pattern) if not path.is_relative_to(without)}
        if not here:
            raise InputError(
                f"no recording is found by {pattern}: name how they end, as in 'missions/**/*.mcap' (with quotes)"
            )
        found |= here
    return sorted(found)


def _matches(pattern: str) -> Iterator[Path]:
    if Path(pattern).exists() or not has_magic(pattern):
        path = Path(realpath(pattern))
        if path.exists():
            yield _bag_of(path)
        return
    for path in map(_bag_of, map(Path, map(realpath, glob(pattern, recursive=True)))):
        is_named = path.suffix in (*_SUFFIXES, Path(pattern).suffix or ".csv")
        if (path / _METADATA).is_file() or (is_named and path.is_file()):
            yield path


def _bag_of(path: Path) -> Path:
    """Return the folder of the bag of which a path is a part, else the path."""
    is_part = path.suffix in _SUFFIXES[1:] and path.is_file() and (path.parent / _METADATA).is_file()
    return path.parent if is_part else path


Run = Callable[[list[Task]], Iterable[tuple[Task, str]]]
"""Does tasks, and yields each as it is done, with what kept its result from being written."""

Progress = Callable[[int, int], None]
"""Called with the number of recordings that are done, and of all."""


def require_separate_folder(out: Path, inputs: Iterable[Path]) -> None:
    """Check that nothing which a batch writes into its folder overwrites what it reads.

    Parameters
    ----------
    out : Path
        Folder of the results; inputs may lie in it, but not where results go.
    inputs : iterable of Path
        Recordings, array and calibration.

    Raises
    ------
    InputError
        When an input would be overwritten, or the folder is none, a bag or lies inside one.
    """
    if out.exists() and not out.is_dir():
        raise InputError(f"{out} cannot be written: it is no folder")
    require_separate([out / name for name in (*SUMMARIES, _RECORDINGS, _LOCK)], inputs)


def run_batch(recordings: list[Path], out: Path, options: Options, run: Run, progress: Progress) -> list[Result]:
    """Finish a batch, write its summaries, and return all results in the order of the summaries.

    Parameters
    ----------
    recordings : list of Path
        Absolute.
    out : Path
        Folder of the results, which is made where there is none.
    options : Options
        What is asked for every recording.
    run : callable
        Does the tasks.
    progress : callable
        Called with what is done, and of how much.

    Raises
    ------
    InputError
        When the folder cannot be written.
    Refused
        When another batch is writing into the folder.
    """
    with _owning(out):
        tasks = [Task.of(path, out, options) for path in recordings]
        left = [task for task in tasks if not task.is_done()]
        kept = len(tasks) - len(left)
        progress(kept, len(tasks))
        lost: dict[Path, str] = {}
        for done, (task, problem) in enumerate(run(left) if left else (), start=kept + 1):
            if problem:
                lost[task.path] = problem
            progress(done, len(tasks))
        results = sorted((_result(task, lost.get(task.path, "")) for task in tasks), key=_order)
        write_summaries(out, results)
    return results


def _result(task: Task, problem: str) -> Result:
    result = None if problem else read_result(task.folder)
    return result or task.result("failed", {"run": problem or f"its result is not in {task.folder}"})


def _order(result: Result) -> tuple[str, float, str]:
    """By platform and time; what could not be read comes first."""
    return result.platform, result.time_span_s[0] if result.time_span_s else 0.0, result.path


@contextmanager
def _owning(out: Path) -> Iterator[None]:
    """Hold the folder for one batch at a time; what this one or a killed one left unfinished, and the lock, go."""
    made = [folder for folder in (out, *out.parents) if not folder.exists()]
    with ExitStack() as stack:
        try:
            stack.callback(_remove_empty, made)
            out.mkdir(parents=True, exist_ok=True)
            lock = out / _LOCK
            holder = _hold(lock)
        except BlockingIOError:
            raise Refused(f"another batch is writing into {out}: wait for it, or name another folder") from None
        except OSError as problem:
            raise InputError(f"{out} cannot be written: {problem.strerror}") from None
        stack.callback(os.close, holder)
        stack.callback(lock.unlink)
        stack.callback(_remove_unfinished, out)
        _remove_unfinished(out)
        yield


def _hold(lock: Path) -> int:
    """Make a lock and hold it, as `hold` does."""
    while True:
        lock.touch()
        with suppress(FileNotFoundError):  # the batch that held it has just removed it
            return hold(lock)


def _remove_unfinished(out: Path) -> None:
    for part in (*out.glob(".summary.*"), *out.glob(f"{_RECORDINGS}/*/.*")):
        remove_left_over(part)
    _remove_empty([*out.glob(f"{_RECORDINGS}/*"), out / _RECORDINGS])


def _remove_empty(folders: Iterable[Path]) -> None:
    for folder in folders:
        with suppress(OSError):
            folder.rmdir()
