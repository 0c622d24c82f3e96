"""Drivers with clocks of their own: processes that share no stamp, as on a robot."""

import re
import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from ros_bench import field_of_array, rows_of, write_driver

from tam_calibration.cli.main import main
from tam_calibration.messages.point_cloud import MAGNETIC_FIELD, SampleLayout
from tam_calibration.recordings import read_array, read_samples, write_array
from tam_calibration.recordings.bag_writing import TYPESTORE, write_bag
from tam_calibration.results import read_calibration
from tam_calibration.results.calibration_yaml import calibration_from_yaml

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

TOPICS = [*(f"tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4)), "scalar/intensity"]
NOISE_T = 1e-9


@dataclass(frozen=True)
class Drivers:
    """Four sensors' drivers and the scalar's: periods, offsets, jitter, lateness of stamps and length of a run, s.

    They publish faster than the stamps by ``speed``.
    """

    periods_s: tuple = (0.01,) * 4
    offsets_s: tuple = (0, 2.5e-3, 5e-3, 7.5e-3)
    jitter_s: float = 0.0
    scalar_period_s: float = 0.01
    late_s: tuple = (0,) * 5
    span_s: float = 20.0
    speed: float = 1.0
    seed: int = 4

    @property
    def counts(self):
        """Readings of each driver."""
        return [int(self.span_s / period) for period in (*self.periods_s, self.scalar_period_s)]

    def start(self, bench, errors, folder):
        """Start the drivers with what they publish; return them and what tells them to begin, at the same time."""
        random = np.random.default_rng(self.seed)
        commands = {}
        *counts, scalar_count = self.counts
        sensors = zip(TOPICS, counts, self.periods_s, self.offsets_s, self.late_s, strict=False)
        for sensor, (topic, count, period, offset, late) in enumerate(sensors):
            time_s = offset + period * np.arange(count) + random.uniform(0, 2 * self.jitter_s, count)
            readings = errors.distort(field_of_array(time_s))[:, sensor] + NOISE_T * random.normal(size=(count, 3))
            commands[f"driver_{sensor + 1}"] = write_driver(folder, topic, time_s + late, readings, self.speed)
        time_s = 1e-3 + self.scalar_period_s * np.arange(scalar_count)
        intensity = np.linalg.norm(field_of_array(time_s), axis=1) + 1e-10 * random.normal(size=scalar_count)
        stamps_s, readings = time_s + self.late_s[-1], intensity[:, None] * [1, 0, 0]
        commands["driver_scalar"] = write_driver(folder, TOPICS[-1], stamps_s, readings, self.speed)
        children = bench.fork(commands)
        return children, partial(begin, bench, len(commands))


def begin(bench, count):
    """Tell so many drivers to begin; return when, in seconds, and what told them.

    A first word, that is none, is acknowledged by those that hear the publisher, so that the second is heard in time.
    """
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, QoSProfile

    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    publisher = bench.node.create_publisher(std_msgs.Float64, "begin", latched)
    bench.spin_until(lambda: publisher.get_subscription_count() == count, "the drivers are there")
    publisher.publish(std_msgs.Float64(data=float("nan")))
    assert publisher.wait_for_all_acked(Duration(seconds=30))
    begin_s = time.time() + 0.2
    publisher.publish(std_msgs.Float64(data=begin_s))
    return begin_s, publisher


def heard(bench):
    """Wait until the collector has matched the drivers."""
    wanted = {(f"publishers./{topic}", "1") for topic in TOPICS}
    bench.health("collector", lambda _, figures: wanted <= figures.items(), "the drivers are heard")


def test_sensors_with_clocks_of_their_own_are_calibrated(bench, true_errors, tmp_path):
    """99 % of sensor 1's readings are used, and the gradient's error is that of the noise.

    Clocks run freely and jitter, one sensor has half the rate, and the scalar a seventh.
    """
    case = Drivers((0.015, 0.015 * (1 + 1e-4), 0.015, 0.03), (0,) * 4, 2e-3, 0.1)
    bench.start_nodes(collector={}, calibrator={})
    _, begin_now = case.start(bench, true_errors, tmp_path)
    heard(bench)
    begin_now()
    count = case.counts[0]
    bench.health("collector", lambda _, figures: figures.get("tam_1.received") == str(count), "all readings have come")
    answer = bench.call("/calibrator/calibrate")
    assert answer.success, answer.message
    used = re.search(r"(\d+) of \d+ samples of sensor 1 used", answer.message)
    assert int(used[1]) >= 0.99 * count
    calibrations = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: calibrations, "the calibration is published")
    calibration = calibration_from_yaml(calibrations[0].data, "the topic")
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.05 * calibration.floor.tensor_rmse_T_per_m


LATE_S = (0, 17.3e-3, -8.1e-3, 4.6e-3, 30e-3)
"""How much later than they were read the readings of four sensors and the scalar are stamped."""


def record(bench, case, errors, folder):
    """Let the drivers run and keep in a bag what they publish; return when they began."""
    messages = []
    for topic in TOPICS:
        keep = partial(lambda topic, message: messages.append((topic, message)), topic)
        bench.node.create_subscription(sensor_msgs.MagneticField, topic, keep, 10_000, raw=True)
    children, begin_now = case.start(bench, errors, folder)
    bench.spin_until(lambda: all(map(bench.node.count_publishers, TOPICS)), "the drivers are heard")
    begin_s, publisher = begin_now()
    bench.spin_until(lambda: len(messages) == sum(case.counts), "all readings have come")
    assert not any(children.end().values())
    bench.node.destroy_publisher(publisher)
    with write_bag(folder / "late.mcap", "mcap") as writer:
        connections = {
            topic: writer.add_connection(f"/{topic}", MAGNETIC_FIELD, typestore=TYPESTORE) for topic in TOPICS
        }
        for index, (topic, message) in enumerate(messages):
            writer.write(connections[topic], index, message)
    return begin_s


def scalar_places(times_s, scalar_T, begin_s):
    """Return where in the tenths of a second after the begin the scalar has readings, hundredths of a second."""
    return set((np.round(100 * (times_s[np.isfinite(scalar_T)] - begin_s)).astype(int) % 10).tolist())


def test_delays_that_nobody_knew_are_estimated_from_a_bag_and_taken_off_live(bench, true_errors, cross, tmp_path):
    """With them in the array file the error of the live gradient is that of the noise, as its standard errors say.

    The scalar's is stated: its readings join the samples that they were taken with.
    """
    case = Drivers(late_s=LATE_S, scalar_period_s=0.1, span_s=10.0, speed=4.0)
    begin_s = record(bench, case, true_errors, tmp_path)
    bag, array, calibration = (str(tmp_path / name) for name in ("late.mcap", "array.yaml", "calibration.yaml"))
    write_array(array, replace(cross, scalar_delay_s=LATE_S[-1]))
    recording = read_samples(bag, array=read_array(array)).recording
    assert scalar_places(recording.time_s, recording.scalar_T, begin_s) == {0}
    asked = ["calibrate", bag, "--array", array, "--estimate-delays", "-o", calibration]
    answer = CliRunner().invoke(main, asked)
    assert answer.exit_code == 0, answer.stderr
    assert np.abs(read_calibration(calibration).array.delay_s - LATE_S[:4]).max() < 50e-6
    stated = re.search(r"delay_s: (\[.*?\])", answer.stdout.replace("\n", " "))[0]
    with Path(array).open("a") as file:
        file.write(f"{stated}\n")

    bench.start_nodes(collector={"array_file": array}, corrector={"array_file": array, "calibration_file": calibration})
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    bench.health("corrector", lambda _, figures: figures.get("subscribers./field_gradient") == "1", "it is connected")
    later = replace(case, span_s=3.0, speed=1.0, seed=5)
    _, begin_now = later.start(bench, true_errors, tmp_path)
    heard(bench)
    begin_s, _ = begin_now()
    count = later.counts[0]
    bench.spin_until(lambda: len(outputs) >= 0.9 * count, "the readings are corrected")
    gradient, told = np.split(rows_of(outputs), [9], axis=1)
    assert np.sqrt(np.mean((gradient[:, 3:] / told[:, 3:]) ** 2)) < 1.05
    rows = rows_of(samples)
    assert scalar_places(rows[:, 0], rows[:, SampleLayout.whole(4).columns.index("scalar_T")], begin_s) == {0}
