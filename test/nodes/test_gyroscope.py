"""The angular velocity on line: averaged to the samples, from the topic that a map names, and what it has bought."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import dive, rates_of_dive

from tam_calibration.core.interpolation import AveragedRates
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.recording import RATE_COLUMNS, Recording
from tam_calibration.model.units import from_degrees
from tam_calibration.recordings import write_array

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
geometry_msgs = pytest.importorskip("geometry_msgs.msg")

GYROSCOPE = Gyroscope(from_degrees(4e-3), from_degrees(0.1))
RATE_HZ, QUICKER, COUNT = 10, 4, 60
MAP = """
sensors: [{topic: tam_1/magnetic_field}, {topic: tam_2/magnetic_field}, {topic: tam_3/magnetic_field},
          {topic: tam_4/magnetic_field}]
scalar: {topic: scalar/intensity, type: sensor_msgs/msg/MagneticField, unit: T}
gyroscope: {topic: gyro, field: vector, type: geometry_msgs/msg/Vector3Stamped}
"""


@pytest.fixture
def run(true_errors, cross):
    """Return six seconds at 10 Hz, the array with a gyroscope, and the angular velocities (240, 3) at 40 Hz."""
    rng, time_s = np.random.default_rng(5), 1.7e9 + np.arange(COUNT * QUICKER) / (RATE_HZ * QUICKER)
    rows = dive(true_errors, cross, rng, time_s[::QUICKER] - 1.7e9)
    recording = Recording(time_s[::QUICKER], rows[:, 1:-2].reshape(COUNT, 4, 3), rows[:, -2])
    return recording, replace(cross, gyroscope=GYROSCOPE), rates_of_dive(GYROSCOPE, rng, time_s - 1.7e9)


def imu(stamp, rates):
    """Return the message of an IMU without attitude."""
    message = sensor_msgs.Imu(angular_velocity=geometry_msgs.Vector3(**dict(zip("xyz", rates, strict=True))))
    message.header.stamp = stamp
    message.orientation_covariance[0] = -1.0
    return message


def vector(stamp, rates):
    """Return a message that only a map can tell to be an angular velocity."""
    message = geometry_msgs.Vector3Stamped(vector=geometry_msgs.Vector3(**dict(zip("xyz", rates, strict=True))))
    message.header.stamp = stamp
    return message


@pytest.mark.parametrize("is_mapped", [False, True])
def test_samples_hold_the_mean_angular_velocity(bench, run, tmp_path, is_mapped):
    """As offline; the health says how well biases are known by the turn so far, with the gyroscope and without."""
    from rclpy.time import Time

    from tam_calibration.nodes.topics import read_cloud

    recording, array, rates = run
    write_array(tmp_path / "array.yaml", array)
    (tmp_path / "map.yaml").write_text(MAP)
    parameters = {"array_file": tmp_path / "array.yaml"} | ({"map_file": tmp_path / "map.yaml"} if is_mapped else {})
    bench.start_nodes(collector=parameters)
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    topic, make = ("gyro", vector) if is_mapped else ("imu/data", imu)
    publisher = bench.node.create_publisher(type(make(Time().to_msg(), np.zeros(3))), topic, 1000)
    bench.spin_until(publisher.get_subscription_count, "the gyroscope is subscribed")
    publish_readings = bench.publish_sensors()
    bench.connect(collector={"samples": 1})
    stamps_ns = np.round(1e9 * recording.time_s[0]).astype(int) + np.arange(len(rates)) * 10**9 // (RATE_HZ * QUICKER)

    def publish(recording, index):
        for each in range(max(0, QUICKER * (index - 1) + 1), QUICKER * index + 1):
            publisher.publish(make(Time(nanoseconds=int(stamps_ns[each])).to_msg(), rates[each].tolist()))
        bench.spin_until(lambda: True, "at once")
        publish_readings(recording, index)
        bench.spin_until(lambda: len(samples) >= index - 1, "samples come back")

    bench.play(recording, publish, samples)
    found = np.concatenate([read_cloud(cloud)[1] for cloud in samples])
    columns = [read_cloud(samples[0])[0].index(name) for name in RATE_COLUMNS]
    averaged = AveragedRates()
    averaged.add(stamps_ns, rates)
    expected = averaged.means(stamps_ns[::QUICKER], rates[::QUICKER])
    is_there = np.isfinite(found[:, columns[0]])
    assert is_there.mean() > 0.9
    away = np.abs(found[is_there][5:, columns] - expected[is_there][5:]).max(axis=1)
    assert np.median(away) < 1e-4  # a message that comes after its sample is in no mean

    def is_bought(status, figures):
        return float(figures.get("bias_error_with_gyroscope_T", "inf")) < float(figures.get("bias_error_T", "0"))

    status, _ = bench.health("collector", is_bought, "it says what the gyroscope brings")
    assert "biases are known to" in status.message and "without the gyroscope to" in status.message
