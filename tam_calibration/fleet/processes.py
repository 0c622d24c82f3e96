"""Processes that end with the block that uses them, however that ends."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext, SpawnContext
from threading import Thread
from typing import TypeVar

from tam_calibration.files.whole_files import remove_unfinished, temporary_place
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.signals import postponed

Task = TypeVar("Task")
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


def submit_all(
    pool: ProcessPoolExecutor, work: Callable[[Task], Done], tasks: Iterable[Task]
) -> dict[Future[Done], Task]:
    """Hand in tasks, and return them by what will hold their results.

    A signal waits until that is done: a process that is just being started would not be ended with the others.

    Parameters
    ----------
    pool : ProcessPoolExecutor
        As `processes` gives it.
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
