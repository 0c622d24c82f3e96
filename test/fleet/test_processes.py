"""Processes end with the block that uses them, however long their work would take."""

import os
import resource
import select
import signal
from multiprocessing import get_context
from tempfile import mkdtemp

import pytest

from tam_calibration.files.text_files import UNFINISHED
from tam_calibration.fleet.batch import processes, submit_all
from tam_calibration.model.exceptions import InputError

PATIENCE_S = 30


@pytest.mark.parametrize("how", ["forkserver", "spawn"])
@pytest.mark.parametrize("end", [SystemExit(143), RuntimeError("a failure")], ids=repr)
def test_a_failure_ends_them_at_once(how, end):
    """A task that waits for ever holds up nothing."""
    with pytest.raises(type(end)), processes(1, get_context(how)) as pool:
        watched = os.pidfd_open(pool.submit(os.getpid).result())
        pool.submit(signal.pause)
        raise end
    assert select.select([watched], [], [], PATIENCE_S)[0] == [watched]
    os.close(watched)


def test_a_system_without_room_for_semaphores_is_told():
    """Its own word for it is "Error"."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, hard))
    try:
        with pytest.raises(InputError, match="is there room in /dev/shm"), processes(1, get_context("spawn")):
            pass
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("end", [None, SystemExit(143)], ids=repr)
def test_they_leave_no_temporary_folder(tmp_path, monkeypatch, end):
    """Neither when they are done, as they end without a word to what they keep, nor when they are ended."""
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    try:
        with processes(1, get_context("spawn")) as pool:
            assert pool.submit(mkdtemp, UNFINISHED, ".tam.").result().startswith(str(tmp_path))
            if end is not None:
                raise end
    except SystemExit:
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_signal_waits_until_all_are_started(capfd):
    """One that came while a process was being started left it alone: it failed with a traceback."""

    def tasks():
        yield 1
        signal.raise_signal(signal.SIGTERM)
        yield 2

    handed_in = []

    def end(number, frame):
        raise SystemExit(143)

    before = signal.signal(signal.SIGTERM, end)
    try:
        with pytest.raises(SystemExit), processes(2, get_context("forkserver")) as pool:
            submit_all(pool, abs, map(lambda task: handed_in.append(task) or task, tasks()))
    finally:
        signal.signal(signal.SIGTERM, before)
    assert handed_in == [1, 2] and capfd.readouterr().err == ""


def test_what_is_begun_is_done(tmp_path):
    """At the end of the block all results are there."""
    with processes(2, get_context("forkserver")) as pool:
        futures = [pool.submit(abs, -number) for number in range(5)]
    assert [future.result(timeout=0) for future in futures] == list(range(5))
