"""A long run with a fault every some seconds: what the calibrator said is saved is there at the end.

``make soak`` lets it last for twenty minutes.
"""

import os
import resource
import signal
import sqlite3
import time
from itertools import count

import numpy as np
import pytest
from nodes.hostile import hostile_messages
from ros_bench import NO_ROS, node_command

from battery.trial import pick
from tam_calibration.fit import calibrate
from tam_calibration.results import calibration_to_yaml

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason=NO_ROS)
std_msgs = pytest.importorskip("std_msgs.msg", reason=NO_ROS)

SOAK_S = float(os.environ.get("SOAK_S", "0"))
"""How long it lasts."""

BETWEEN_S = min(10.0, SOAK_S / 5)
"""Time from one fault to the next."""

FAULT_S = min(3.0, BETWEEN_S / 2)
"""How long a sensor is silent, or a disk full."""

RATE_HZ = 100
NODES = ("collector", "calibrator", "corrector", "localizer")
BAD_MESSAGES = 300


@pytest.mark.skipif(not SOAK_S, reason="it takes the whole machine: make soak, or SOAK_S=20 pytest")
def test_every_sample_that_was_acknowledged_is_there(bench, recording, cross, tmp_path):
    """Killed nodes, silent sensors, bad messages and full disks, in random order and each at least once."""
    seed = int(os.environ.get("SOAK_SEED", np.random.SeedSequence().entropy % 2**32))
    print(f"again: SOAK_SEED={seed}")
    soak = Soak(bench, recording, tmp_path / "samples", np.random.default_rng(seed))
    soak.begin(std_msgs.String(data=calibration_to_yaml(calibrate(recording, cross))))
    faults = [soak.kill, soak.silence, soak.send_bad_messages, soak.fill_disk]
    limit = time.monotonic() + SOAK_S
    order = list(soak.rng.permutation(len(faults)))
    while time.monotonic() < limit:
        soak.wait(BETWEEN_S)
        faults[order.pop() if order else soak.rng.integers(len(faults))]()
    soak.wait(BETWEEN_S)
    soak.end()
    there = soak.stamps_on_disk()
    print(f"{soak.published} samples published, {len(soak.acknowledged)} acknowledged, {len(there)} on disk")
    assert soak.acknowledged <= there.keys()
    assert len(soak.acknowledged) > 0.3 * soak.published
    for stamp_ns in soak.acknowledged:
        np.testing.assert_array_equal(there[stamp_ns], soak.sent[stamp_ns])


class Soak:
    """A run that is streamed, and what happens to it.

    Attributes
    ----------
    acknowledged : set of int
        Stamps of the samples of which the calibrator said that they are saved, nanoseconds.
    sent : dict of int to (12,) array
        The readings by their stamps.
    """

    def __init__(self, bench, recording, path, rng):
        self._bench, self._recording, self._path, self.rng = bench, recording, path, rng
        self._children, self._told = {}, []
        self.acknowledged, self.sent = set(), {}

    @property
    def published(self):
        """The number of samples so far."""
        return len(self.sent)

    def begin(self, calibration):
        """Start the nodes one by one and stream."""
        from diagnostic_msgs.msg import DiagnosticArray
        from rclpy.qos import QoSProfile

        from tam_calibration.nodes.topics import LATCHED

        for name in NODES:
            self._start(name)
        others, second = (
            self._bench.publish_sensors(each, scalar) for each, scalar in (((1, 3, 4), True), ((2,), False))
        )
        self._streams, self._second = [others, second], second
        indices = count()

        def publish_next():
            index = next(indices)
            lap, row = divmod(index, self._recording.sample_count)
            stamp_ns = round((self._recording.time_s[row] + 10 * lap) * 1e9)
            self.sent[stamp_ns] = self._recording.readings_T[row].ravel()
            for publish in self._streams:
                publish(self._recording, index)

        self._bench.node.create_timer(1 / RATE_HZ, publish_next)
        self._bench.node.create_subscription(DiagnosticArray, "/diagnostics", self._hear, 100)
        header = sensor_msgs.MagneticField().header
        good = {
            "tam_2/magnetic_field": sensor_msgs.MagneticField(header=header),
            "imu/data": sensor_msgs.Imu(header=header),
            "temperature": sensor_msgs.Temperature(header=header),
            "calibration": calibration,
        }
        create = self._bench.node.create_publisher
        self._bad = {
            topic: create(type(each), topic, LATCHED if topic == "calibration" else QoSProfile(depth=100))
            for topic, each in good.items()
        }
        self._messages = hostile_messages(good, self.rng)

    def _hear(self, message):
        """Note which samples are on disk when the calibrator says how many it has saved."""
        for status in message.status:
            saved = next((int(value.value) for value in status.values if value.key == "saved"), 0)
            if status.name == "calibrator" and saved > len(self.acknowledged):
                self.acknowledged |= set(list(self.stamps_on_disk())[:saved])

    def stamps_on_disk(self):
        """Return the readings (12,) of the samples in the calibrator's file, by their stamps, in order."""
        with sqlite3.connect(f"file:{self._path}?mode=ro", uri=True) as file:
            rows = file.execute("SELECT stamp_ns, row FROM samples ORDER BY number").fetchall()
        return {stamp_ns: np.frombuffer(row)[1:13] for stamp_ns, row in rows}

    def _start(self, name):
        parameters = {"samples_file": self._path} if name == "calibrator" else {}
        self._children[name] = self._bench.start({name: node_command(name, parameters)})
        self._bench.spin_until(lambda: name in self._bench.node.get_node_names(), f"{name} is seen")

    def wait(self, duration_s):
        """Let the run go on."""
        limit = time.monotonic() + duration_s
        self._bench.spin_until(lambda: time.monotonic() > limit, "time goes on", timeout_s=10 * duration_s + 60)

    def kill(self):
        """Kill a node at any moment, and start it again."""
        self._restart(pick(self.rng, NODES))

    def _restart(self, name):
        self._children[name].end_one(name, signal.SIGKILL)
        self._start(name)

    def silence(self):
        """Let a sensor be silent for a while."""
        self._streams.remove(self._second)
        self.wait(FAULT_S)
        self._streams.append(self._second)

    def send_bad_messages(self):
        """Send what no node can use."""
        for _ in range(BAD_MESSAGES):
            topic, message = next(self._messages)
            self._bad[topic].publish(message)
            self._bench.executor.spin_once(timeout_sec=0.0)

    def fill_disk(self):
        """Let the calibrator write nothing for a while; then somebody makes room and starts it anew."""
        process = self._children["calibrator"].pids["calibrator"]
        [before, most] = resource.prlimit(process, resource.RLIMIT_FSIZE)
        resource.prlimit(process, resource.RLIMIT_FSIZE, (0, most))
        self.wait(FAULT_S)
        resource.prlimit(process, resource.RLIMIT_FSIZE, (before, most))
        self._restart("calibrator")

    def end(self):
        """End the calibrator in order, which saves what is left."""
        assert self._children["calibrator"].end_one("calibrator") == 0
