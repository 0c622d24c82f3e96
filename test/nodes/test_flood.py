"""A flood of messages that mean harm, and of calls: no node ends, memory stays, and the run's samples are all there."""

import os
import time
from itertools import count

import numpy as np
import pytest
from nodes.hostile import hostile_messages, own_memory_bytes
from numpy.testing import assert_array_equal
from ros_bench import NO_ROS, node_command

from tam_calibration.fit import calibrate
from tam_calibration.results import calibration_to_yaml, write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason=NO_ROS)
std_msgs = pytest.importorskip("std_msgs.msg", reason=NO_ROS)

FLOOD_S = float(os.environ.get("FLOOD_S", "0"))
"""How long it lasts: a minute in `make battery`."""

GROWTH_BYTES = 24 << 20
"""Most that a node may grow by in a flood, after all services were called once: pools of an allocator, no list."""

SERVICES = ("collector/usage", "calibrator/calibrate", "calibrator/diagnose", "calibrator/save")
A_SAMPLE = 5
"""Hostile messages for each sample of the run."""
NUMBERS_BYTES = 168
"""At the end of a cloud, at most."""
BEGIN = 50
"""Samples before the flood."""


@pytest.mark.skipif(not FLOOD_S, reason="it takes the whole machine: make battery, or FLOOD_S=5 pytest")
def test_nothing_ends_and_nothing_is_lost_in_a_flood(bench, recording, cross, tmp_path):
    """Malformed messages of every type, hostile calibrations and 200 calls of a service at once, beside a run."""
    seed = int(os.environ.get("FLOOD_SEED", np.random.SeedSequence().entropy % 2**32))
    print(f"again: FLOOD_SEED={seed}")
    calibration = calibrate(recording, cross)
    write_calibration(tmp_path / "calibration.yaml", calibration)
    loaded = {"calibration_file": tmp_path / "calibration.yaml"}
    parameters = {
        "collector": {},
        "calibrator": {"gap_file": tmp_path / "gap.json", "samples_file": tmp_path / "samples"},
        "corrector": loaded,
        "localizer": loaded,
    }
    nodes = bench.start({name: node_command(name, own) for name, own in parameters.items()})
    publish = bench.publish_sensors()
    flood = Flood(bench, recording, publish)
    bench.connect(collector={"samples": 4}, corrector={"field_gradient": 2})
    bench.play(recording, publish, flood.samples, last=BEGIN)
    bench.spin_until(lambda: len(flood.outputs) == BEGIN, "each is corrected")
    flood.begin(std_msgs.String(data=calibration_to_yaml(calibration)), np.random.default_rng(seed))

    memory_bytes = []
    for _ in range(2):
        flood.go_on(FLOOD_S / 2)
        for service in SERVICES:
            assert len(bench.storm(service)) == 200
        bench.health("calibrator", lambda _, figures: not figures["busy_with"], "the calibrator is done")
        memory_bytes.append({name: own_memory_bytes(process) for name, process in nodes.pids.items()})
    before, after = memory_bytes
    growth = {name: after[name] - before[name] for name in before}
    print(f"{len(flood.samples)} samples; growth in bytes: {growth}")
    assert max(growth.values()) < GROWTH_BYTES, growth

    assert_array_equal([flood.readings_of(cloud) for cloud in flood.samples], flood.published())
    stored = str(len(flood.samples))
    bench.health("calibrator", lambda _, figures: figures["samples"] == stored, f"{stored} samples are stored")
    bench.spin_until(lambda: len(flood.outputs) == len(flood.samples), "each is corrected")


class Flood:
    """Samples of a run, each followed by messages that mean harm.

    Attributes
    ----------
    samples, outputs : list of bytes
        What collector and corrector made; what means harm, and comes on the same topics, is left out.
    """

    def __init__(self, bench, recording, publish):
        self._bench, self._recording, self._publish = bench, recording, publish
        self._next, self._sent = count(BEGIN), BEGIN
        self.samples, self.outputs = [self._listen(topic) for topic in ("samples", "field_gradient")]

    def _listen(self, topic):
        """Return a list to which the clouds of a topic are appended that are like the first one."""
        heard = []

        def take(message):
            if not heard or _form(message) == _form(heard[0]):
                heard.append(message)

        from rclpy.qos import QoSProfile

        node = self._bench.node
        node.create_subscription(sensor_msgs.PointCloud2, topic, take, QoSProfile(depth=1000), raw=True)
        return heard

    def begin(self, calibration, rng):
        """Make the publishers of what means harm, from a good message of each type that is read."""
        from rclpy.qos import QoSProfile
        from rclpy.serialization import deserialize_message

        from tam_calibration.nodes.topics import LATCHED

        sample, gradient = (
            deserialize_message(clouds[-1], sensor_msgs.PointCloud2) for clouds in (self.samples, self.outputs)
        )
        field = sensor_msgs.MagneticField(header=sample.header)
        good = {
            "tam_2/magnetic_field": field,
            "scalar/intensity": field,
            "imu/data": sensor_msgs.Imu(header=sample.header),
            "temperature": sensor_msgs.Temperature(header=sample.header),
            "current": std_msgs.Float64(),
            "samples": sample,
            "field_gradient": gradient,
            "calibration": calibration,
        }
        qualities = dict.fromkeys(good, QoSProfile(depth=100)) | {"calibration": LATCHED}
        create = self._bench.node.create_publisher
        self._publishers = {topic: create(type(each), topic, qualities[topic]) for topic, each in good.items()}
        are_heard = self._publishers.values()
        self._bench.spin_until(lambda: all(each.get_subscription_count() for each in are_heard), "the flood is heard")
        self._messages = hostile_messages(good, rng)

    def go_on(self, duration_s):
        """Publish samples, no faster than they come back, and what means harm between them."""
        limit = time.monotonic() + duration_s
        while time.monotonic() < limit:
            self._publish(self._recording, next(self._next))
            self._sent += 1
            for _ in range(A_SAMPLE):
                topic, message = next(self._messages)
                self._publishers[topic].publish(message)
            self._bench.spin_until(lambda: len(self.samples) >= self._sent - 20, "the samples come back")
        self._bench.spin_until(lambda: len(self.samples) >= self._sent, "all samples come back")

    def readings_of(self, cloud):
        """Return the readings (12,) of a sample that the collector made, tesla."""
        from rclpy.serialization import deserialize_message

        from tam_calibration.nodes.topics import read_cloud

        [row] = read_cloud(deserialize_message(cloud, sensor_msgs.PointCloud2))[1]
        return row[1:13]

    def published(self):
        """Return the readings (N, 12) that were published, tesla."""
        laps = -(-self._sent // self._recording.sample_count)
        return np.tile(self._recording.readings_T.reshape(-1, 12), (laps, 1))[: self._sent]


def _form(message):
    """Return all of a serialised cloud of one row but its stamp and its numbers."""
    return len(message), message[12:-NUMBERS_BYTES]
