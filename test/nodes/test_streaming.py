"""The stream of serialised messages: what cannot be used, quality of service, names, clocks, processes, executors."""

import sys

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from ros_bench import rows_of

from tam_calibration.fit import calibrate
from tam_calibration.model.recording import Recording
from tam_calibration.recordings.bag_writing import TYPESTORE
from tam_calibration.results import read_calibration, write_calibration

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")

SENSORS = [f"tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4)]
FIELD = "sensor_msgs/msg/MagneticField"


@pytest.fixture(scope="module")
def calibration_file(recording, cross, tmp_path_factory):
    """Return the path of a calibration's file."""
    path = tmp_path_factory.mktemp("calibration") / "calibration.yaml"
    write_calibration(path, calibrate(recording, cross))
    return path


def serialised(stamp_ns, vector, little_endian=True, frame_id="sensor"):
    """Return a serialised MagneticField."""
    types = TYPESTORE.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    header = types["std_msgs/msg/Header"](stamp, frame_id)
    message = types[FIELD](header, types["geometry_msgs/msg/Vector3"](*vector), np.zeros(9))
    return bytes(TYPESTORE.serialize_cdr(message, FIELD, little_endian=little_endian))


def sensors_of(bench):
    """Return publishers of the sensors, once the collector has matched them."""
    publishers = [bench.node.create_publisher(sensor_msgs.MagneticField, topic, 1000) for topic in SENSORS]
    bench.spin_until(lambda: all(each.get_subscription_count() for each in publishers), "the sensors are subscribed")
    bench._sensor_topics += SENSORS
    return publishers


def test_what_cannot_be_used_is_counted_and_costs_nothing_else(bench, recording):
    """Damaged messages and NaN are logged once and counted; big-endian messages and other frames are read."""
    children = bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publishers = sensors_of(bench)
    bench.connect(collector={"samples": 1})
    for index, readings in enumerate(recording.readings_T[:30]):
        stamp_ns = (index + 1) * 10**7
        if index == 10:
            for bad in (b"\0\1\0\0", serialised(stamp_ns, readings[1])[:40], b"\7\7\7\7" + bytes(100)):
                publishers[1].publish(bad)
            publishers[1].publish(serialised(stamp_ns, [np.nan, 0.0, 0.0]))
        for sensor, publisher in enumerate(publishers):
            publisher.publish(serialised(stamp_ns, readings[sensor], sensor != 2, "frame" * sensor))
    bench.spin_until(lambda: len(samples) == 30, "every sample")
    assert_array_equal(rows_of(samples)[:, 1:13], recording.readings_T[:30].reshape(30, 12))
    stamps = [cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec for cloud in samples]
    assert stamps == [(index + 1) * 10**7 for index in range(30)]
    counted = "unusable.tam_2/magnetic_field"
    _, figures = bench.health("collector", lambda _, figures: counted in figures, "they are counted")
    assert figures[counted] == "4" and figures["tam_2.received"] == "34"
    told = [line for line in children.log("collector").splitlines() if "]: tam_2/magnetic_field: " in line]
    assert len(told) == 1 and "damaged" in told[0]


def test_a_stuck_array_does_not_end_the_collector(bench):
    """Readings that never change are samples as any other: the coverage says what is missing."""
    bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 1})
    readings = np.tile([2e-5, 1e-5, -4e-5], (50, 4, 1))
    bench.play(Recording(1.7e9 + np.arange(50) / 100, readings, np.full(50, 5e-5)), publish, samples)
    status, figures = bench.health("collector", lambda _, figures: figures.get("samples") == "50", "it is told")
    assert figures["enough"] == "False" and "turn the array" in status.message


def test_quality_of_service_and_names_can_be_changed(bench):
    """Parameters override the quality of one topic and no other; remapping moves topics."""
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    overrides = ["-p", "qos_overrides./tam_1/magnetic_field.subscription.reliability:=reliable"]
    overrides += ["-p", "qos_overrides./moved.publisher.depth:=7", "-r", "samples:=moved"]
    overrides += ["-p", "qos_overrides./moved.publisher.durability:=transient_local"]
    bench.fork({"collector": ["-m", "tam_calibration.nodes.start", "collector", "--ros-args", *overrides]})
    bench.spin_until(lambda: all(map(bench.node.count_subscribers, SENSORS)), "the collector subscribes")
    infos = [bench.node.get_subscriptions_info_by_topic(f"/{topic}")[0].qos_profile for topic in SENSORS]
    assert [info.reliability == ReliabilityPolicy.RELIABLE for info in infos] == [True, False, False, False]
    bench.spin_until(lambda: bench.node.count_publishers("/moved") == 1, "the samples are published elsewhere")
    assert bench.node.count_publishers("/samples") == 0
    [moved] = bench.node.get_publishers_info_by_topic("/moved")
    assert moved.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL


def test_samples_flow_while_the_clock_of_a_simulation_stands_still(bench, recording):
    """With use_sim_time and no /clock, samples and diagnostics come as ever, with the stamps of the sensors."""
    bench.start_nodes(collector={"use_sim_time": True}, calibrator={"use_sim_time": True})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(recording, publish, samples, last=20)
    assert_array_equal(rows_of(samples)[:, 0], recording.time_s[:20])
    bench.stored(20)


def test_two_nodes_in_one_process_do_what_two_processes_do(bench, recording, calibration_file):
    """The outputs of ``stream`` equal those offline bit for bit, and each node tells its health."""
    arguments = ["--ros-args", "-p", f"corrector:calibration_file:={calibration_file}"]
    bench.fork({"stream": ["-m", "tam_calibration.nodes.start", "stream", *arguments]})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    outputs = bench.listen(sensor_msgs.PointCloud2, "field_gradient")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2}, corrector={"field_gradient": 1})
    bench.play(recording, publish, samples, last=100)
    bench.spin_until(lambda: len(outputs) == 100, "all are corrected")
    offline = read_calibration(calibration_file).apply(rows_of(samples)[:, 1:13].reshape(100, 4, 3))
    assert_array_equal(rows_of(outputs)[:, :9], offline)
    bench.health("corrector", lambda _, figures: figures["corrected"] == "100", "it is counted")


def test_without_the_executor_of_events_the_default_one_is_taken(monkeypatch, ros_domain):
    """An rclpy without the experimental executor is enough."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    from tam_calibration.nodes import session

    monkeypatch.setitem(sys.modules, "rclpy.experimental.events_executor", None)
    rclpy.init()
    try:
        assert isinstance(session._cheapest_executor(), SingleThreadedExecutor)
    finally:
        rclpy.shutdown()
