"""Processes end with the block that uses them, however long their work would take."""

import os
import select
import signal
from multiprocessing import get_context

import pytest

from tam_calibration.fleet.processes import processes

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


def test_what_is_begun_is_done(tmp_path):
    """At the end of the block all results are there."""
    with processes(2, get_context("forkserver")) as pool:
        futures = [pool.submit(abs, -number) for number in range(5)]
    assert [future.result(timeout=0) for future in futures] == list(range(5))
