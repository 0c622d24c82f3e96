"""A collector that stands still for seconds: what comes when it goes on is joined, and what was lost is called lost."""

import json
import os
import signal

import numpy as np
import pytest
from nodes.test_drivers import TOPICS, begin, heard
from ros_bench import field_of_array, write_driver

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

COUNT, FIRST, LAST = 1600, 300, 1300
"""Samples at 100 Hz, and the first and the last that are published while the collector stands still: 10 s."""


@pytest.fixture
def stall(bench, true_errors, tmp_path, monkeypatch):
    """Return a function that stops a collector for 10 s; it returns its log, usage, status and figures at the end."""

    def stop_and_go_on(reliability, has_profile):
        time_s = np.arange(COUNT) / 100
        field = field_of_array(time_s)
        scalar = np.linalg.norm(field, axis=1)[:, None] * [1, 0, 0]
        streams = zip(TOPICS, [*true_errors.distort(field).transpose(1, 0, 2), scalar], strict=True)
        quality = {f"qos_overrides./{topic}.subscription.reliability": reliability for topic in TOPICS}
        nodes = bench.start_nodes(collector=quality)
        if not has_profile:
            monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "DEFAULT")
            monkeypatch.delenv("FASTRTPS_DEFAULT_PROFILES_FILE")
        bench.fork({topic: write_driver(tmp_path, topic, time_s, own) for topic, own in streams})
        published = bench.listen(sensor_msgs.MagneticField, TOPICS[0])
        heard(bench)
        _begun_s, _publisher = begin(bench, len(TOPICS))
        bench.spin_until(lambda: len(published) >= FIRST, "it runs")
        os.kill(nodes.pids["collector"], signal.SIGSTOP)
        bench.spin_until(lambda: len(published) >= LAST, "it stands still")
        os.kill(nodes.pids["collector"], signal.SIGCONT)

        def is_read(_, figures):
            counts = [int(figures[f"tam_{k}.received"]) + int(figures[f"tam_{k}.lost"]) for k in (1, 2, 3, 4)]
            return counts == [COUNT] * 4

        status, figures = bench.health("collector", is_read, "all is read or lost")
        usage = json.loads(bench.call("collector/usage").message)
        return nodes.log("collector"), usage, status, figures

    return stop_and_go_on


@pytest.mark.parametrize(
    ("reliability", "has_profile"), [("best_effort", True), ("reliable", True), ("reliable", False)]
)
def test_nothing_is_lost_in_ten_seconds(stall, reliability, has_profile):
    """Queues hold it; drivers without our profile of Fast DDS send again what they are asked for, one after another."""
    log, usage, _, figures = stall(reliability, has_profile)
    assert (usage["used"], usage["received"], usage["reasons"]) == (COUNT, COUNT, [])
    assert figures["steps"] == "0" and "WARN" not in log


def test_what_is_lost_is_called_lost(stall):
    """Drivers without our profile overwrite what nobody read: it is counted, in the usage and by no step of a clock."""
    log, usage, status, figures = stall("best_effort", False)
    lost = int(figures["tam_1.lost"])
    assert lost > 100 and usage["received"] == COUNT and usage["used"] >= COUNT - lost - 2
    assert f"{lost} were lost on the way: look at the load" in usage["reasons"]
    assert "were lost on the way" in status.message and "were lost on the way" in log
    assert figures["steps"] == "0" and "stepped" not in log + status.message
