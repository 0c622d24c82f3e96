"""Tasks on a Dask cluster whose workers see the recordings and the results under the same paths."""

from collections.abc import Iterator
from typing import Any

from tam_calibration.exceptions import InputError
from tam_calibration.fleet.task import Task, process

CONNECT_S = 10.0


def run_on_cluster(tasks: list[Task], scheduler: str) -> Iterator[tuple[Task, str]]:
    """Do tasks on the workers of a scheduler; yield each as it is done, with what kept its result from being written.

    Raises
    ------
    InputError
        When Dask is not installed, or the scheduler does not answer or has no worker.
    """
    try:
        import distributed
    except ImportError:
        raise InputError("--scheduler needs Dask: pip install 'tam_calibration[fleet]'") from None
    dask: Any = distributed  # typed in part
    with _connect(dask.Client, scheduler) as client:
        futures = [client.submit(process, task, pure=False) for task in tasks]
        by_key = {future.key: task for future, task in zip(futures, tasks, strict=True)}
        for future in dask.as_completed(futures):
            yield by_key[future.key], _sentence(future)


def _sentence(future: Any) -> str:
    if future.cancelled():
        return "the cluster gave it up: did its scheduler end?"
    problem = future.exception()
    return "" if problem is None else f"{type(problem).__name__}: {problem}"


def _connect(connect: Any, scheduler: str) -> Any:
    try:
        client = connect(scheduler, timeout=CONNECT_S)
    except (OSError, ValueError) as problem:
        raise InputError(f"no scheduler answers at {scheduler}: give its address, as in tcp://host:8786") from problem
    if not client.scheduler_info()["workers"]:
        client.close()
        raise InputError(f"the scheduler at {scheduler} has no worker: start one with dask worker {scheduler}")
    return client
