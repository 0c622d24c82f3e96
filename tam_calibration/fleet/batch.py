"""A batch of the recordings that patterns name: what is done is kept, processes do the rest, all is summed up.

Processes of this machine end with the block that uses them, however that ends.
"""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from glob import glob, has_magic
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, SpawnContext
from os.path import realpath
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from tam_calibration.files.text_files import hold, remove_left_over, remove_unfinished, temporary_place
from tam_calibration.fleet.summary import SUMMARIES, write_summaries
from tam_calibration.fleet.task import Options, Result, Task, process, read_result
from tam_calibration.messages.samples import Progress
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.libraries import require, use_one_thread
from tam_calibration.model.signals import postponed
from tam_calibration.recordings.bag_storages import METADATA, STORAGES
from tam_calibration.results.overwriting import require_separate

Given = TypeVar("Given")
Done = TypeVar("Done")


@contextmanager
def processes(jobs: int, context: ForkServerContext | SpawnContext) -> Iterator[ProcessPoolExecutor]:
    """Give processes that are done with their tasks when the block ends, and end at once when it fails.

    Parameters
    ----------
    jobs : int
        Number of processes that work at once.
    context : multiprocessing context
        How they are started; not forked from this one, whose end they would miss.

    Raises
    ------
    InputError
        When the system gives no semaphores.
    """
    # Closed at this end, also by the end of this process, it tells the other.
    told, telling = context.Pipe(duplex=False)
    with told, telling:
        try:
            pool = ProcessPoolExecutor(jobs, context, initializer=_begin, initargs=(told,))
        except OSError as problem:  # without a word on its reason
            raise InputError("no processes can work together here: is there room in /dev/shm?") from problem
        try:
            yield pool
        except BaseException:
            telling.close()
            pool.shutdown(cancel_futures=True)
            raise
        else:
            pool.shutdown()
        finally:
            remove_unfinished(temporary_place())  # which processes that end at once leave


def submit_all(pool: Executor, work: Callable[[Given], Done], tasks: Iterable[Given]) -> dict[Future[Done], Given]:
    """Hand in tasks, and return them by what will hold their results.

    A signal waits until that is done: a process that is just being started would not be ended with the others.

    Parameters
    ----------
    pool : Executor
        As `processes` gives it, or a cluster.
    work : callable
        Does a task.
    tasks : iterable
        What it is called with.
    """
    with postponed():
        return {pool.submit(work, task): task for task in tasks}


def _begin(told: Connection) -> None:
    """Let this process end at an interrupt, without a word, and when it is told."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    Thread(target=_end_when_told, args=(told,), daemon=True).start()


def _end_when_told(told: Connection) -> None:
    told.poll(None)
    os._exit(1)


_PRELOADED = (process.__module__, "tam_calibration.results.bag_corrected", "scipy.optimize", "scipy.spatial.transform")
"""What every task loads sooner or later: loaded once, before the processes are forked."""


def run_here(tasks: list[Task], jobs: int) -> Iterator[tuple[Task, str]]:
    """Do tasks in processes; yield each as it is done, with what kept its result from being written.

    When a process is killed, as the system does when memory runs out, the tasks that were not done yet are done one
    after another, each in a process of its own, so that one of them cannot take the others with it.

    Parameters
    ----------
    tasks : list of Task
        One for each recording.
    jobs : int
        Number of processes that work at once.

    Returns
    -------
    iterator of (Task, str)
        With an empty text where the result was written.
    """
    use_one_thread()
    left = []
    for task, problem in _in_pool(tasks, jobs):
        if isinstance(problem, BrokenProcessPool):
            left.append(task)
        else:
            yield task, _in_words(problem)
    for task in left:
        for _, problem in _in_pool([task], 1):
            yield task, _in_words(problem)


def _in_pool(tasks: list[Task], jobs: int) -> Iterator[tuple[Task, BaseException | None]]:
    # Forked from a process that has imported everything once, not from this one with its threads.
    context = get_context("forkserver")
    context.set_forkserver_preload(list(_PRELOADED))
    try:
        with processes(jobs, context) as pool:
            yield from _as_done(pool, tasks)
    except BrokenProcessPool as problem:  # while tasks were handed in
        yield from ((task, problem) for task in tasks)


def _as_done(pool: Executor, tasks: list[Task]) -> Iterator[tuple[Task, BaseException | None]]:
    futures = submit_all(pool, process, tasks)
    for future in as_completed(futures):
        yield futures[future], CancelledError() if future.cancelled() else future.exception()


def _in_words(problem: BaseException | None) -> str:
    if problem is None:
        return ""
    if isinstance(problem, CancelledError):
        return "the cluster gave it up: did its scheduler end?"
    if isinstance(problem, BrokenProcessPool):
        return "its process was killed: did memory run out? Cut the recording, or give the batch more memory"
    return f"{type(problem).__name__}: {problem}"


CONNECT_S = 10.0
"""For a scheduler to answer: one that runs does at once, also in another building."""


def run_on_cluster(tasks: list[Task], scheduler: str) -> Iterator[tuple[Task, str]]:
    """Do tasks on the workers of a scheduler; yield each as it is done, with what kept its result from being written.

    Parameters
    ----------
    tasks : list of Task
        One for each recording; workers see the same paths.
    scheduler : str
        Address of a Dask scheduler, as in tcp://host:8786.

    Returns
    -------
    iterator of (Task, str)
        With an empty text where the result was written.

    Raises
    ------
    InputError
        When Dask is not installed, or the scheduler does not answer or has no worker.
    """
    require("fleet", "--scheduler")
    import distributed

    dask: Any = distributed  # typed in part
    try:
        connected = dask.Client(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as problem:
        raise InputError(f"no scheduler answers at {scheduler}: give its address, as in tcp://host:8786") from problem
    with connected as client:
        if not client.scheduler_info()["workers"]:
            raise InputError(f"the scheduler at {scheduler} has no worker: start one with dask worker {scheduler}")
        for task, cause in _as_done(client.get_executor(pure=False), tasks):
            yield task, _in_words(cause)


_SUFFIXES = (".csv", ".zstd", *(storage.suffix for storage in STORAGES.values()))
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
        matches = set(_matches(pattern))
        here = {path for path in matches if not path.is_relative_to(without)}
        if matches and not here:
            raise InputError(f"{pattern} lies in {without}, where the results go: name another folder with -o")
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
        if (path / METADATA).is_file() or (is_named and path.is_file()):
            yield path


def _bag_of(path: Path) -> Path:
    """Return the folder of the bag of which a path is a part, else the path."""
    is_part = path.suffix in _SUFFIXES[1:] and path.is_file() and (path.parent / METADATA).is_file()
    return path.parent if is_part else path


Run = Callable[[list[Task]], Iterable[tuple[Task, str]]]
"""Does tasks, and yields each as it is done, with what kept its result from being written."""


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
    """Finish a batch, as ``tam batch`` does: each recording calibrated, diagnosed and corrected, and all summed up.

    Parameters
    ----------
    recordings : list of Path
        Absolute, as ``find_recordings`` returns them.
    out : Path
        Folder of the results, which is made where there is none.
    options : Options
        What is asked for every recording, from ``read_options``.
    run : callable
        Does the tasks: ``run_here`` in processes of this machine, ``run_on_cluster`` on others.
    progress : callable
        Called with what is done, and of how much.

    Returns
    -------
    list of Result
        In the order of the summaries.

    Raises
    ------
    InputError
        When the folder cannot be written.
    Refused
        When another batch is writing into the folder.

    Examples
    --------
    >>> from functools import partial
    >>> from pathlib import Path
    >>> from tam_calibration import read_scenario, run_batch, simulate
    >>> from tam_calibration.fleet.batch import find_recordings, run_here
    >>> from tam_calibration.fleet.task import read_options
    >>> from tam_calibration.recordings.channel_map import AS_IT_IS
    >>> from tam_calibration.results import write_recording
    >>> write_recording(Path("dive_1.csv"), simulate(read_scenario("wu_table_1")).recording)
    >>> _ = Path("array.yaml").write_text("{baseline_m: 0.5, vector_noise_nT: 1.0, scalar_noise_nT: 0.1}")
    >>> out, options = Path("out"), read_options(Path("array.yaml"), None, AS_IT_IS)
    >>> paths = find_recordings(["*.csv"], without=out)
    >>> results = run_batch(paths, out, options, partial(run_here, jobs=1), progress=lambda done, total: None)
    >>> [(result.recording, result.status) for result in results]
    [('dive_1.csv', 'done')]
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
