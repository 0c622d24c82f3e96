"""The same work on a Dask cluster: a scheduler and two workers, as processes of their own."""

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace

import pytest

from tam_calibration.fleet.processes import run_here, run_on_cluster
from tam_calibration.fleet.task import Task, process, read_result
from tam_calibration.model.exceptions import InputError

NO_DASK = "Dask is not installed: pip install 'tam_calibration[fleet]'"
START_S = 60


@pytest.fixture
def start(tmp_path):
    """Return a function that starts a part of a cluster; at the end all are stopped."""
    with ExitStack() as stack:

        def start(part, *options):
            command = [
                sys.executable,
                "-m",
                f"distributed.cli.dask_{part}",
                *options,
                "--scheduler-file",
                "scheduler.json",
            ]
            log = stack.enter_context((tmp_path / f"{part}.log").open("a"))
            child = subprocess.Popen(command, cwd=tmp_path, stdout=log, stderr=log)
            stack.callback(child.wait)
            stack.callback(child.terminate)
            return child

        yield start


@pytest.fixture
def scheduler(tmp_path, start):
    """Start a scheduler and return its address."""
    pytest.importorskip("distributed", reason=NO_DASK)
    child = start("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
    limit = time.monotonic() + START_S
    while time.monotonic() < limit:
        try:
            child.wait(0.05)
        except subprocess.TimeoutExpired:
            try:
                return json.loads((tmp_path / "scheduler.json").read_text())["address"]
            except (OSError, ValueError):
                continue
        break
    raise AssertionError((tmp_path / "scheduler.log").read_text())


@pytest.fixture
def workers(scheduler, start):
    """Start two workers and wait until the scheduler has them; return their names."""
    from distributed import Client

    for name in ("one", "two"):
        start("worker", "--name", name, "--nthreads", "1", "--no-nanny", "--no-dashboard")
    with Client(scheduler, timeout=START_S) as client:
        client.wait_for_workers(2, timeout=START_S)
        return {worker["name"] for worker in client.scheduler_info()["workers"].values()}


def content(folder):
    """Return the bytes of all files below a folder by their relative paths."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_cluster_gives_what_this_machine_gives(folder, options, scheduler, workers):
    """Byte for byte, of a table and of a bag, and with the failure in its place."""
    assert workers == {"one", "two"}
    names = ["auv_1/dive_0.csv", "auv_2/dive_2", "auv_2/damaged.mcap"]
    here, there = (
        [Task.of(folder / "missions" / name, folder / out, options) for name in names] for out in ("here", "there")
    )
    for task in here:
        process(task)
    assert {(task.path, sentence) for task, sentence in run_on_cluster(there, scheduler)} == {
        (task.path, "") for task in there
    }
    assert content(folder / "there") == content(folder / "here")


def test_what_a_worker_cannot_write_is_told(folder, options, scheduler, workers):
    """The failure comes back as a sentence."""
    (folder / "out").write_text("a file")
    task = Task.of(folder / "missions/auv_1/dive_0.csv", folder / "out", options)
    ((_, sentence),) = run_on_cluster([task], scheduler)
    assert sentence.startswith(("NotADirectoryError", "FileExistsError"))


def test_a_scheduler_without_workers_is_refused(scheduler):
    """The batch would wait for ever."""
    with pytest.raises(InputError, match=r"has no worker: start one with dask worker tcp://"):
        list(run_on_cluster([], scheduler))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense://here", "tcp://127.0.0.1"])
def test_a_scheduler_that_does_not_answer_is_named(monkeypatch, address):
    """One sentence, after a bounded time."""
    pytest.importorskip("distributed", reason=NO_DASK)
    monkeypatch.setattr("tam_calibration.fleet.processes.CONNECT_S", 0.5)
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
    names = ["auv_1/dive_0.csv", "auv_1/dive_1.mcap", "auv_2/dive_2"]
    tasks = [Task.of(folder / "missions" / name, folder / "out", options) for name in names]
    tasks[1] = replace(tasks[1], options=Deadly())
    told = {task.path.name: sentence for task, sentence in run_here(tasks, jobs)}
    assert list(map(bool, map(told.get, ("dive_0.csv", "dive_1.mcap", "dive_2")))) == [False, True, False]
    assert "its process was killed: did memory run out?" in told["dive_1.mcap"]
    assert [read_result(task.folder) is not None for task in tasks] == [True, False, True]


def test_what_cannot_be_written_is_told(folder, options):
    """A file stands where the results should go."""
    (folder / "out").write_text("a file")
    task = Task.of(folder / "missions/auv_1/dive_0.csv", folder / "out", options)
    ((_, sentence),) = run_here([task], 1)
    assert sentence.startswith(("NotADirectoryError", "FileExistsError"))
