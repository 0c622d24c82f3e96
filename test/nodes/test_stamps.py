"""Stamps that step and stamps that are false: the nodes as processes keep the run, and say what happened."""

import math
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

YEAR_S = 365 * 86_400
LATEST_S = 2**31 - 1
COUNT = 250


class Drivers:
    """Drivers of four sensors, a scalar and an IMU, which publish a sample with any stamp."""

    def __init__(self, bench):
        self.bench = bench
        topics = [f"tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4)] + ["scalar/intensity"]
        self.fields = [bench.node.create_publisher(sensor_msgs.MagneticField, topic, 1000) for topic in topics]
        self.imu = bench.node.create_publisher(sensor_msgs.Imu, "imu/data", 1000)
        published = [*self.fields, self.imu]
        bench.spin_until(lambda: all(each.get_subscription_count() for each in published), "all are subscribed")
        wanted = {f"publishers./{topic}": "1" for topic in [*topics, "imu/data"]} | {"subscribers./samples": "4"}
        bench.health("collector", lambda _, figures: wanted.items() <= figures.items(), "all are connected")

    def publish(self, recording, index, false=None, infinite=()):
        """Publish a sample, its messages with false stamps by the index of the sensor, its values infinite."""
        from builtin_interfaces.msg import Time
        from geometry_msgs.msg import Vector3

        seconds, fraction = divmod(round(recording.time_s[index] * 1e9), 10**9)
        imu = sensor_msgs.Imu()
        imu.header.stamp = Time(sec=seconds, nanosec=fraction)
        imu.orientation.w = math.inf if "imu" in infinite else 1.0
        self.imu.publish(imu)
        fields = [*recording.readings_T[index].tolist(), [float(recording.scalar_T[index]), 0.0, 0.0]]
        for sensor, (publisher, field) in enumerate(zip(self.fields, fields, strict=True)):
            message = sensor_msgs.MagneticField(magnetic_field=Vector3(x=field[0], y=field[1], z=field[2]))
            stamp = (false or {}).get(sensor, (seconds, fraction))
            message.header.stamp = Time(sec=stamp[0], nanosec=stamp[1])
            publisher.publish(message)


@pytest.fixture
def nodes(bench):
    """Start the nodes; return drivers and the samples that come back."""
    bench.start_nodes(collector={}, calibrator={}, corrector={}, localizer={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    bench.health("localizer", lambda _, figures: figures.get("publishers./samples") == "1", "the localizer is there")
    return Drivers(bench), samples


def stored(bench, count):
    """Wait until the calibrator has stored so many samples."""
    bench.health("calibrator", lambda _, figures: figures.get("samples") == str(count), f"{count} samples are stored")


@pytest.mark.parametrize("step_s", [-0.3, -100.0, 0.5])
def test_a_step_of_the_clock_keeps_the_run(board, recording, step_s):
    """The step is told with its size, at WARN and in the log; coverage and samples of the run are kept."""
    board.play(recording.take(slice(0, 120)))
    _, before = board.bench.health("collector", lambda _, figures: figures["samples"] == "120", "coverage is told")
    later = recording.take(slice(120, 240))
    told = []

    def is_told(status, figures):
        told.extend([status] * ("stepped" in status.message))
        return told and figures["samples"] == "240"

    board.bench.play(later.take(slice(0, 20)), board.publish, board.samples)
    stepped = later.take(slice(20, 120))  # its messages come without a pause
    board.bench.play(replace(stepped, time_s=stepped.time_s + step_s), board.publish, board.samples)
    _, figures = board.bench.health("collector", is_told, "the step is told")
    direction = "back" if step_s < 0 else "ahead"
    assert f" stepped {direction} by {abs(step_s):g} s" in told[0].message
    assert told[0].level == b"\x01" and figures["steps"] == "1"
    assert f"stepped {direction} by {abs(step_s):g} s" in board.bench.children[0].log("collector")
    assert float(figures["fraction"]) >= float(before["fraction"]) and figures["lost"] == "0"
    stored(board.bench, 240)
    answer = board.ask("calibrate")
    assert answer.success and "240 samples" in answer.message, answer.message


def test_a_pause_is_no_step_of_the_clock(board, recording):
    """Where all drivers stop for a while, and stamps go on with the clock, nobody set it."""
    board.play(recording.take(slice(0, 120)))
    stopped_s = time.monotonic()
    board.bench.spin_until(lambda: time.monotonic() > stopped_s + 0.5, "the drivers go on")
    later = recording.take(slice(120, 240))
    board.go_on(replace(later, time_s=later.time_s + time.monotonic() - stopped_s))
    _, figures = board.bench.health("collector", lambda status, _: "no messages of tam_1 for" in status.message, "told")
    assert figures["steps"] == "0" and figures["last_step"].startswith("no messages of tam_1 for ")


FALSE = {
    "zero": (0, 0),
    "a year ahead": (1_700_000_003 + YEAR_S, 5),
    "negative": (-1, 5),
    "long before 1970": (-(2**31), 0),
    "the latest": (LATEST_S, 999_999_999),
    "no time": (LATEST_S, 2**32 - 1),
    "one second back": (1_700_000_001, 100_000_000),
}


def test_a_bad_message_costs_one_sample(bench, recording, nodes):
    """False stamps of one sensor or of all, an infinite attitude and foreign clouds: nothing else is lost, or ends."""
    from std_msgs.msg import Header

    from tam_calibration.messages.point_cloud import SampleLayout
    from tam_calibration.nodes.topics import RELIABLE_STREAM, make_cloud, read_cloud

    drivers, samples = nodes
    foreign = bench.node.create_publisher(sensor_msgs.PointCloud2, "samples", RELIABLE_STREAM)
    bench.health(
        "calibrator", lambda _, figures: figures.get("publishers./samples") == "2", "another publishes samples"
    )
    samples.clear()
    faults = [(stamp, which) for stamp in FALSE.values() for which in (range(5), [0])]
    bad = {30 + 15 * place: fault for place, fault in enumerate(faults)}
    expected = [index for index in range(COUNT) if index not in bad]
    other = SampleLayout(2)
    delivered = 0
    for index in range(COUNT):
        stamp, which = bad.get(index, ((0, 0), ()))
        drivers.publish(recording, index, dict.fromkeys(which, stamp), ["imu"] if index == 238 else ())
        delivered += index not in bad
        bench.spin_until(lambda wanted=delivered - 40: len(samples) >= wanted, f"sample {index} comes back")
    bench.spin_until(lambda: len(samples) == len(expected), "all samples come back")
    rows = np.concatenate([read_cloud(cloud)[1] for cloud in samples])
    assert_array_equal(rows[:, 1:13], recording.readings_T[expected].reshape(-1, 12))
    layout, other = SampleLayout(4, ("scalar", "temperature", "current", "attitude")), SampleLayout(2)
    foreign.publish(make_cloud(Header(), other.columns, [0.0] * len(other.columns)))
    foreign.publish(make_cloud(Header(), ("x", "y", "z")))
    foreign.publish(make_cloud(Header(), layout.columns, [1.0] * len(layout.columns)))
    foreign.publish(make_cloud(Header(), layout.columns, [math.inf] * len(layout.columns)))
    bench.health("calibrator", lambda _, figures: figures.get("unusable.samples") == "3", "foreign clouds are counted")
    stored(bench, len(expected))
    _, figures = bench.health("collector", lambda _, figures: True, "a status")
    assert figures["restarts"] == figures["steps"] == "0"
    assert figures["unusable.imu/data"] == "1"
    assert int(figures["tam_1.implausible"]) + int(figures["unusable.tam_1/magnetic_field"]) == len(bad)
    answer = bench.call("calibrator/calibrate")
    assert answer.success and f"{len(expected)} samples" in answer.message, answer.message
