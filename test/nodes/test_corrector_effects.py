"""The corrector with a calibration that keeps an effect: processes over DDS, the temperature on a topic of its own."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from ros_bench import rows_of

from tam_calibration.gap.calibration_with_effects import calibrate_with_effects
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.results import read_calibration, write_calibration
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

LAYOUT = SampleLayout(4, ("scalar", "temperature", "current", "attitude"))
SILENT_S = 100.0
"""Longer than the collector holds a temperature."""


@pytest.fixture(scope="module")
def drifting():
    """Return a recording whose sensor 2 drifts with temperature."""
    scenario = read_scenario("warming_up")
    return simulate(replace(scenario, sample_count=1000, rate_hz=5.0)).recording


@pytest.fixture(scope="module")
def calibration_file(drifting, tmp_path_factory):
    """Return the path of the calibration that keeps the drift."""
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    write_calibration(path, calibrate_with_effects(drifting, read_scenario("warming_up").array, ["temperature_drift"]))
    return path


def publish_temperature(publisher, time_s, temperature_C):
    """Publish a temperature."""
    from rclpy.time import Time

    message = sensor_msgs.Temperature(temperature=float(temperature_C))
    message.header.stamp = Time(nanoseconds=round(time_s * 1e9)).to_msg()
    publisher.publish(message)


def test_drift_is_taken_off_as_offline_and_a_silent_temperature_is_told(bench, drifting, calibration_file):
    """Live outputs are those of the whole recording; without temperature they are raw, and errors hold the drift."""
    calibration = read_calibration(calibration_file)
    bench.start_nodes(collector={}, corrector={"calibration_file": calibration_file})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    temperature = bench.node.create_publisher(sensor_msgs.Temperature, "temperature", 1000)
    bench.spin_until(temperature.get_subscription_count, "the temperature is subscribed")
    sensors = bench.publish_sensors()
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})

    def publish(recording, index):
        publish_temperature(temperature, recording.time_s[index], recording.temperature_C[index])
        sensors(recording, index)

    publish_temperature(temperature, drifting.time_s[0], drifting.temperature_C[0])
    bench.health("collector", lambda _, figures: figures.get("temperature.received") == "1", "it has a temperature")
    bench.play(drifting, publish, samples, last=60)
    bench.spin_until(lambda: len(outputs) == 60, "all are corrected")

    taken = LAYOUT.recording(rows_of(samples))
    offline = calibration.correct(taken)
    live = rows_of(outputs)
    assert_allclose(live[:, :9], offline.outputs, rtol=1e-9, atol=1e-20)
    assert_allclose(live[:, 9:], np.tile(offline.standard_errors, (60, 1)), rtol=1e-12)
    raw = calibration.apply(taken.readings_T)
    assert np.abs(raw[:, 0] - live[:, 0]).max() > 1e-9
    status, figures = bench.health("corrector", lambda status, _: "noise floor" in status.message, "all is well")
    assert status.level == b"\x00" and figures["effects"] == "temperature_drift" and not figures["effects_left_in"]

    later = replace(drifting, time_s=drifting.time_s + SILENT_S)
    bench.play(later, sensors, samples, first=60, last=80)
    bench.spin_until(lambda: len(outputs) == 80, "all are corrected")
    silent = rows_of(outputs[60:])
    assert_array_equal(silent[:, :9], calibration.apply(later.readings_T[60:80]))
    expected = np.hypot(offline.standard_errors, calibration.effect_sizes[0].rms)
    assert_allclose(silent[:, 9:], np.tile(expected, (20, 1)), rtol=1e-12)
    status, figures = bench.health("corrector", lambda status, _: "stays in" in status.message, "what stays in is told")
    assert status.level == b"\x01" and "needs the temperature" in status.message
    assert figures["effects_left_in"] == "temperature_drift"

    publish_temperature(temperature, later.time_s[80], later.temperature_C[80])
    bench.health("collector", lambda _, figures: figures["temperature.received"] == "62", "it has a temperature")
    sensors(later, 80)
    bench.spin_until(lambda: len(outputs) == 81, "the next is corrected")
    bench.health("corrector", lambda status, _: "stays in" not in status.message, "all is well again")


def test_a_step_of_the_clock_keeps_what_effects_remember(bench, drifting, calibration_file):
    """Live outputs are those of the recording whose stamps never stepped."""
    bench.start_nodes(collector={}, corrector={"calibration_file": calibration_file})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    temperature = bench.node.create_publisher(sensor_msgs.Temperature, "temperature", 1000)
    bench.spin_until(temperature.get_subscription_count, "the temperature is subscribed")
    sensors = bench.publish_sensors()
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})

    def publish(recording, index):
        publish_temperature(temperature, recording.time_s[index], recording.temperature_C[index])
        sensors(recording, index)

    publish_temperature(temperature, drifting.time_s[0], drifting.temperature_C[0])
    bench.health("collector", lambda _, figures: figures.get("temperature.received") == "1", "it has a temperature")
    bench.play(drifting, publish, samples, last=30)
    bench.play(replace(drifting, time_s=drifting.time_s - 3.0), publish, samples, first=30, last=60)
    bench.spin_until(lambda: len(outputs) == 60, "all are corrected")
    rows = rows_of(samples)
    rows[30:, 0] += 3.0
    offline = read_calibration(calibration_file).correct(LAYOUT.recording(rows))
    assert_allclose(rows_of(outputs)[:, :9], offline.outputs, rtol=1e-6, atol=1e-15)


def test_a_sample_that_is_none_is_counted(bench, drifting, calibration_file):
    """An attitude of four zeros, which no collector makes, gives NaN and a warning; the next sample is corrected."""
    from rclpy.time import Time
    from std_msgs.msg import Header

    from tam_calibration.nodes.topics import RELIABLE_STREAM, make_cloud

    bench.start_nodes(corrector={"calibration_file": calibration_file})
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    publisher = bench.node.create_publisher(sensor_msgs.PointCloud2, "samples", RELIABLE_STREAM)
    wanted = {"publishers./samples": "1", "subscribers./field_gradient": "1"}
    bench.health("corrector", lambda _, figures: wanted.items() <= figures.items(), "all are connected")
    for index, attitude in enumerate(([0.0] * 4, [0.0, 0.0, 0.0, 1.0])):
        row = [drifting.time_s[index], *drifting.readings_T[index].ravel(), 5e-5, drifting.temperature_C[index], 0.0]
        header = Header(stamp=Time(nanoseconds=index + 1).to_msg())
        publisher.publish(make_cloud(header, LAYOUT.columns, [*map(float, row), *attitude]))
    bench.spin_until(lambda: len(outputs) == 2, "both are answered")
    first, second = rows_of(outputs)
    assert np.isnan(first[:9]).all() and np.isfinite(second).all()
    bench.health("corrector", lambda _, figures: figures.get("unusable.samples") == "1", "it is counted")
