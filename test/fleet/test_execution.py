"""The same work on a Dask cluster: a scheduler and two workers, as processes of their own."""

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace

import pytest

from tam_calibration.fleet.batch import run_here, run_on_cluster
from tam_calibration.fleet.task import Task, process, read_result
from tam_calibration.model.exceptions import InputError

NO_DASK = "Dask is not installed: pip install 'tam_calibration[fleet]'"
START_S = 60


@dataclass(frozen=True)
class Cluster:
    """A scheduler's address, its workers' names, and what is said while it has none."""

    scheduler: str
    workers: set[str]
    said_without_workers: str


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """Start a scheduler, and then two workers; at the end all are stopped."""
    pytest.importorskip("distributed", reason=NO_DASK)
    from distributed import Client

    folder = tmp_path_factory.mktemp("cluster")
    with ExitStack() as stack:

        def start(part, *options):
            command = [sys.executable, "-m", f"distributed.cli.dask_{part}", "--scheduler-file", "scheduler.json"]
            log = stack.enter_context((folder / f"{part}.log").open("a"))
            child = subprocess.Popen([*command, *options], cwd=folder, stdout=log, stderr=log)
            stack.callback(child.wait)
            stack.callback(child.terminate)

        start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        limit, address = time.monotonic() + START_S, ""
        while not address:
            assert time.monotonic() < limit, (folder / "scheduler.log").read_text()
            time.sleep(0.05)
            with suppress(OSError, ValueError):
                address = json.loads((folder / "scheduler.json").read_text())["address"]
        with pytest.raises(InputError) as refused:
            list(run_on_cluster([], address))
        for name in ("one", "two"):
            start("worker", "--name", name, "--nthreads", "1", "--no-nanny", "--no-dashboard")
        with Client(address, timeout=START_S) as client:
            client.wait_for_workers(2, timeout=START_S)
            workers = {worker["name"] for worker in client.scheduler_info()["workers"].values()}
        yield Cluster(address, workers, str(refused.value))


def content(folder):
    """Return the bytes of all files below a folder by their relative paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_cluster_gives_what_this_machine_gives(folder, options, cluster):
    """Byte for byte, and with the failure in its place."""
    assert cluster.workers == {"one", "two"}
    names = ["auv_2/dive_2", "auv_2/damaged.mcap"]
    here, there = (
        [Task.of(folder / "missions" / name, folder / out, options) for name in names] for out in ("here", "there")
    )
    for task in here:
        process(task)
    assert {(task.path, sentence) for task, sentence in run_on_cluster(there, cluster.scheduler)} == {
        (task.path, "") for task in there
    }
    assert content(folder / "there") == content(folder / "here")


def test_what_a_worker_cannot_write_is_told(folder, options, cluster):
    """The failure comes back as a sentence."""
    (folder / "out").write_text("a file")
    task = Task.of(folder / "missions/auv_1/dive_0.csv", folder / "out", options)
    ((_, sentence),) = run_on_cluster([task], cluster.scheduler)
    assert sentence.startswith(("NotADirectoryError", "FileExistsError"))


def test_a_scheduler_without_workers_is_refused(cluster):
    """The batch would wait for ever."""
    assert "has no worker: start one with dask worker tcp://" in cluster.said_without_workers


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://here", "tcp://127.0.0.1"])
def test_a_scheduler_that_does_not_answer_is_named(monkeypatch, address):
    """One sentence, after a bounded time."""
    pytest.importorskip("distributed", reason=NO_DASK)
    monkeypatch.setattr("tam_calibration.fleet.batch.CONNECT_S", 0.5)
    with pytest.raises(InputError, match=f"no scheduler answers at {address}"):
        list(run_on_cluster([], address))


def test_without_dask_one_sentence_says_how_to_get_it(monkeypatch):
    """The extra is named."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r"pip install 'tam_calibration\[fleet\]'"):
        list(run_on_cluster([], "tcp://127.0.0.1:8786"))


class Deadly:
    """Ends the process that receives it, as the system does where memory runs out."""

    def __reduce__(self):
        """Name the function that makes it anew."""
        return os._exit, (1,)


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_process_that_is_killed_loses_its_own_task_only(folder, options, jobs):
    """All others are done, and the one that was lost is told."""
    names = ["one.mcap", "deadly.mcap", "two.mcap"]
    for name in names:  # a damaged recording is a result like others, without a fit
        (folder / name).write_text("no bag")
    tasks = [Task.of(folder / name, folder / "out", options) for name in names]
    tasks[1] = replace(tasks[1], options=Deadly())
    told = {task.path.name: sentence for task, sentence in run_here(tasks, jobs)}
    assert [bool(told[name]) for name in names] == [False, True, False]
    assert "its process was killed: did memory run out?" in told["deadly.mcap"]
    assert [read_result(task.folder) is not None for task in tasks] == [True, False, True]


def test_what_cannot_be_written_is_told(folder, options):
    """A file stands where the results should go."""
    (folder / "out").write_text("a file")
    task = Task.of(folder / "missions/auv_1/dive_0.csv", folder / "out", options)
    ((_, sentence),) = run_here([task], 1)
    assert sentence.startswith(("NotADirectoryError", "FileExistsError"))
