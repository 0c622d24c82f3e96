"""Tasks on the cores of this machine, or on a Dask cluster whose workers see the same paths.

Processes of this machine end with the block that uses them, however that ends.
"""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import get_context
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, SpawnContext
from threading import Thread
from typing import Any, TypeVar

from tam_calibration.files.text_files import remove_unfinished, temporary_place
from tam_calibration.fleet.task import Task, process
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.libraries import require, use_one_thread
from tam_calibration.model.signals import postponed

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
