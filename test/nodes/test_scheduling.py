"""Precedence over processes that only compute: taken where the user may, and told either way."""

import os
import sys
from subprocess import run

import pytest

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'tam_calibration[ros]'")

PRECEDE = """
import os, threading
from tam_calibration.nodes.session import precede
hold = threading.Event()
earlier = threading.Thread(target=hold.wait)
earlier.start()
print(precede())
later = threading.Thread(target=hold.wait)
later.start()
threads = [int(thread) for thread in os.listdir("/proc/self/task")]
print({(os.sched_getscheduler(thread), os.sched_getparam(thread).sched_priority) for thread in threads})
hold.set()
"""


def may_precede():
    """Return whether this user may use real-time priorities."""
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return True


@pytest.mark.skipif(not may_precede(), reason="this user may not use real-time priorities")
def test_every_thread_precedes_at_the_lowest_of_real_time_priorities():
    """Threads that were there and threads that come later; no other real-time process has to wait for them."""
    told, threads = run([sys.executable, "-c", PRECEDE], capture_output=True, text=True, check=True).stdout.splitlines()
    assert told == "real-time, priority 1"
    assert threads == str({(os.SCHED_RR, 1)})


def test_without_the_right_to_precede_all_stays_as_it_is(monkeypatch):
    """A user without rights is told so."""
    from tam_calibration.nodes.session import precede

    def refuse(thread, policy, parameters):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert precede() == "normal: this user may not use real-time priorities"
    assert os.sched_getscheduler(0) == os.SCHED_OTHER


def test_a_parameter_leaves_a_node_among_the_others(bench):
    """With ``real_time`` false a collector is scheduled as all are, and says so."""
    children = bench.start_nodes(collector={"real_time": False})
    bench.health("collector", lambda _, figures: figures.get("scheduling") == "normal", "it is told")
    assert os.sched_getscheduler(children.pids["collector"]) == os.SCHED_OTHER
