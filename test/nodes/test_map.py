"""Topics of strange names and types, read by a map."""

import json
import time

import numpy as np
import pytest
from numpy.testing import assert_allclose

from test.nodes.test_streaming import rows_of

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
geometry_msgs = pytest.importorskip("geometry_msgs.msg")
std_msgs = pytest.importorskip("std_msgs.msg")

TOPICS = """
sensors:
  - {topic: /drivers/a, unit: uT}
  - {topic: /drivers/b, field: vector, unit: uT}
  - {topic: /imu_raw, field: linear_acceleration, unit: G}
  - {topic: /mag3}
scalar: {topic: /overhauser, field: data, scale_nT: 0.5}
attitude: {topic: /pose, field: quaternion, world: ned}
temperature: {topic: /barometer, field: fluid_pressure}
"""

LIST = """
time: received
sensors:
  - {topic: adc, fields: ["data[0]", "data[1]", "data[2]"], unit: nT, type: std_msgs/msg/Float64MultiArray}
  - {topic: adc, fields: ["data[3]", "data[4]", "data[5]"], unit: nT}
  - {topic: adc, fields: ["data[6]", "data[7]", "data[8]"], unit: nT}
  - {topic: adc, fields: ["data[9]", "data[10]", "data[11]"], unit: nT}
scalar: {topic: adc, field: "data[12]", unit: nT}
temperature: {topic: adc, field: humidity}
"""


def publishers(bench, types):
    """Return publishers of topics, each with its type, once somebody listens to all."""
    made = {topic: bench.node.create_publisher(kind, topic, 1000) for topic, kind in types.items()}
    bench.spin_until(lambda: all(each.get_subscription_count() for each in made.values()), "all are subscribed")
    return made


def test_messages_of_any_type_become_samples(bench, recording, tmp_path):
    """Vectors in several units and types, an unstamped scalar and channels; types are found once they are published."""
    from geometry_msgs.msg import Quaternion, Vector3
    from rclpy.time import Time

    (tmp_path / "map.yaml").write_text(TOPICS)
    bench.start_nodes(collector={"map_file": tmp_path / "map.yaml"})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    bench.health(
        "collector", lambda status, _: "no message yet on /drivers/a, /drivers/b" in status.message, "it waits"
    )
    types = {
        "/drivers/a": geometry_msgs.Vector3Stamped,
        "/drivers/b": geometry_msgs.Vector3Stamped,
        "/imu_raw": sensor_msgs.Imu,
        "/overhauser": std_msgs.Float32,
        "/pose": geometry_msgs.QuaternionStamped,
        "/barometer": sensor_msgs.FluidPressure,
        "/mag3": sensor_msgs.MagneticField,
    }
    made = publishers(bench, types)
    bench.connect(collector={"samples": 1})

    def publish(recording, index):
        stamp = Time(nanoseconds=round(recording.time_s[index] * 1e9)).to_msg()
        a, b, c, d = (Vector3(x=x, y=y, z=z) for x, y, z in (recording.readings_T[index] * SCALES).tolist())
        contents = {
            "/overhauser": {"data": float(recording.scalar_T[index] * 2e9)},
            "/pose": {"quaternion": Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)},
            "/barometer": {"fluid_pressure": 20.0 + index},
            "/imu_raw": {"linear_acceleration": c},
            "/drivers/b": {"vector": b},
            "/mag3": {"magnetic_field": d},
            "/drivers/a": {"vector": a},
        }
        for topic, fields in contents.items():
            message = types[topic](**fields)
            if hasattr(message, "header"):
                message.header.stamp = stamp
            made[topic].publish(message)

    bench.play(recording, publish, samples, last=30)
    rows = rows_of(samples)
    assert_allclose(rows[:, 0], recording.time_s[:30], rtol=1e-15)
    assert_allclose(rows[:, 1:13], recording.readings_T[:30].reshape(30, 12), rtol=1e-14)
    scalar_T = rows[np.isfinite(rows[:, 13]), 13]  # without stamps each joins the sample that comes next
    assert len(scalar_T) > 20
    assert np.isin(np.round(scalar_T * 2e9), np.round((recording.scalar_T[:30] * 2e9).astype(np.float32))).all()
    late = 20.0 + np.arange(30) - rows[:, 14]  # the newest that has come is held: DDS keeps no order between topics
    assert np.isin(late, [0.0, 1.0]).all() and np.sum(late == 0) > 20
    assert_allclose(np.abs(rows[:, -7:-3]), np.sqrt(0.5) * np.array([[1, 1, 0, 0]] * 30), atol=1e-15)  # north-east-down


SCALES = np.array([1e6, 1e6, 1e4, 1.0])[:, None]


def test_numbers_of_one_list_are_several_sensors_and_what_is_missing_is_counted(bench, recording, tmp_path):
    """By the time of arrival; missing readings by sensor and reason, in /diagnostics and for the calibrator."""
    (tmp_path / "map.yaml").write_text(LIST)
    bench.start_nodes(collector={"map_file": tmp_path / "map.yaml"})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    adc = publishers(bench, {"adc": std_msgs.Float64MultiArray})["adc"]
    bench.connect(collector={"samples": 1})
    data = np.column_stack([recording.readings_T.reshape(-1, 12), recording.scalar_T])[:40] * 1e9
    data[20, 4], data[21, 6:9], data[22, 9:12], data[23, 3] = np.nan, 0.0, [3e6, 0.0, 1.0], -32768.0
    begin_s = time.time()
    for row in data.tolist():
        adc.publish(std_msgs.Float64MultiArray(data=row))
    bench.spin_until(lambda: len(samples) >= 36, "the samples")
    rows = rows_of(samples)
    assert_allclose(rows[:20, 1:14], data[:20] * 1e-9, rtol=1e-14)
    stamps = [cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec for cloud in samples]
    assert begin_s <= stamps[0] / 1e9 <= stamps[-1] / 1e9 <= time.time() and sorted(set(stamps)) == stamps
    told = [
        "1 of 40 readings of sensor 2 is NaN or blank",
        "1 of 40 readings of sensor 3 is zero on all axes",
        "1 of 40 readings of sensor 4 is far outside the range of the others",
        "1 of 40 readings of sensor 2 is a sentinel",
    ]
    bench.health("collector", lambda _, figures: figures["missing_readings"] == "; ".join(told), "it counts")
    assert json.loads(bench.call("collector/usage").message)["missing"] == told
    adc.publish(std_msgs.Float64MultiArray(data=data[0].tolist()))
    lacking = "1 messages of adc cannot be used: adc has no humidity: it has layout.data_offset, data[0]"
    bench.health("collector", lambda status, _: lacking in status.message, "a field that the type lacks is named")
