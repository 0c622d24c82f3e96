"""Topics of the nodes: in which order messages are read, and clouds that are filled in and read without objects."""

import os
import signal
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from test.nodes.test_streaming import rows_of

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")


def test_a_collector_that_waits_for_its_turn_loses_nothing(bench, recording):
    """What five topics bring in half a second at 1000 Hz waits for a collector that the machine gives no time."""
    children = bench.start_nodes(collector={})
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 1})
    fast = replace(recording, time_s=1.7e9 + np.arange(recording.sample_count) / 1000)
    os.kill(children.pids["collector"], signal.SIGSTOP)
    for index in range(500):
        publish(fast, index)
    os.kill(children.pids["collector"], signal.SIGCONT)
    bench.spin_until(lambda: len(samples) == 500, "every sample")
    assert_array_equal(rows_of(samples)[:, 1:13], recording.readings_T[:500].reshape(500, 12))
    _, figures = bench.health("collector", lambda _, figures: figures.get("samples") == "500", "they are counted")
    assert figures["lost"] == "0"


def test_messages_that_wait_come_in_the_order_of_their_arrival(ros_domain):
    """Whichever topic wakes the node: messages of two topics come as they were published."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Float64

    from tam_calibration.messages.cdr import BODY, unpack_from
    from tam_calibration.nodes.topics import RELIABLE_STREAM, ListeningNode

    context = rclpy.Context()
    rclpy.init(context=context)
    node, came = ListeningNode("ears", context=context), []
    topics, arrived = ["first", "second"], []

    def take(message, arrived_ns):
        came.extend(unpack_from(message, "d", BODY))
        arrived.append(arrived_ns)

    for topic in topics:
        node.listen_in_order(Float64, topic, take, RELIABLE_STREAM)
    publishers = [node.create_publisher(Float64, topic, RELIABLE_STREAM) for topic in topics]
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    while not all(each.get_subscription_count() for each in publishers):
        executor.spin_once(timeout_sec=0.01)
    for number in range(200):
        publishers[number // 3 % 2].publish(Float64(data=float(number)))
    while len(came) < 200:
        executor.spin_once(timeout_sec=1.0)
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()
    assert came == list(range(200)) and sorted(arrived) == arrived and 0 <= arrived[-1] - arrived[0] < 60e9


sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

COLUMNS = ("time_s", "b1x_T", "gxx_standard_error")
OTHER = ("a", "bc")
STAMP_NS = 1_700_000_000_123_456_789


def read(messages):
    """Return columns, stamp and values of each row that a reader gives, and what it refuses."""
    from tam_calibration.nodes.topics import CloudReader, from_stamp

    refused = []
    rows = [
        (each.columns, from_stamp(stamp), row.tolist())
        for each in CloudReader(refused.append, lambda columns: None).read(messages)
        for stamp, row in zip(each.stamps, each.values, strict=True)
    ]
    return rows, refused


def cloud(stamp_ns, columns, rows, frame_id="f"):
    """Return a serialised cloud of any number of rows as rclpy makes it."""
    from rclpy.serialization import serialize_message
    from rclpy.time import Time

    from tam_calibration.nodes.topics import make_cloud

    header = std_msgs.Header(stamp=Time(nanoseconds=stamp_ns).to_msg(), frame_id=frame_id)
    message = make_cloud(header, columns, [0.0] * len(columns))
    message.width, message.row_step = len(rows), 8 * len(columns) * len(rows)
    message.data = np.array(rows, dtype=float).tobytes()
    return bytes(serialize_message(message))


@pytest.mark.parametrize("frame_id", ["", "a", "abc", "abcd", "tam_array"])
@pytest.mark.parametrize("columns", [("x",), COLUMNS, tuple(f"column_{number}" * number for number in range(1, 20))])
def test_a_written_cloud_is_the_one_that_rclpy_makes(columns, frame_id):
    """Stamp, frame, fields and numbers of a written cloud are those asked for, whatever the lengths of the names."""
    from rclpy.serialization import deserialize_message

    from tam_calibration.nodes.topics import cloud_writer, read_cloud, to_stamp

    row = np.random.default_rng(0).normal(size=len(columns))
    written = cloud_writer(columns, frame_id).message(to_stamp(STAMP_NS), row.tobytes())
    message = deserialize_message(written, sensor_msgs.PointCloud2)
    assert message == deserialize_message(cloud(STAMP_NS, columns, [row], frame_id), sensor_msgs.PointCloud2)
    assert_array_equal(read_cloud(message)[1], [row])
    assert read([written]) == ([(columns, STAMP_NS, row.tolist())], [])


KINDS = st.sampled_from(["one row", "other columns", "other frame", "none", "three rows", "damaged", "big-endian"])


@settings(max_examples=50, deadline=None)
@given(kinds=st.lists(KINDS, max_size=12))
def test_clouds_of_any_kind_are_read_in_their_order(kinds):
    """Each row comes once, with its stamp and columns; what is damaged or of another byte order is told."""
    expected, messages, bad = [], [], 0
    for number, kind in enumerate(kinds):
        columns = OTHER if kind == "other columns" else COLUMNS
        count = {"none": 0, "three rows": 3}.get(kind, 1)
        rows = [[float(number + 10 * index)] * len(columns) for index in range(count)]
        message = cloud(number, columns, rows, "frame" if kind == "other frame" else "f")
        if kind == "damaged":
            message, rows, bad = message[:50], [], bad + 1
        elif kind == "big-endian":
            message, rows, bad = b"\0\0" + message[2:], [], bad + 1
        messages.append(message)
        expected += [(columns, number, row) for row in rows]
    rows, refused = read(messages)
    assert rows == expected and len(refused) == bad


def test_other_messages_are_written_as_rclpy_makes_them():
    """A stamped vector with covariance, a point, and a matrix without header."""
    from geometry_msgs.msg import PointStamped
    from rclpy.serialization import deserialize_message

    from tam_calibration.nodes.topics import MessageWriter, to_stamp

    stamp, doubles = to_stamp(STAMP_NS), np.arange(1.0, 13.0)
    header = std_msgs.Header(frame_id="tam_array")
    field = deserialize_message(
        MessageWriter(sensor_msgs.MagneticField(header=header), 12).message(stamp, doubles.tobytes()),
        sensor_msgs.MagneticField,
    )
    assert (field.magnetic_field.x, field.magnetic_field.z) == (1.0, 3.0)
    assert field.magnetic_field_covariance.tolist() == doubles[3:].tolist()
    assert (field.header.stamp.sec, field.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
    point = deserialize_message(
        MessageWriter(PointStamped(header=header), 3).message(stamp, doubles[:3].tobytes()), PointStamped
    )
    assert (point.point.x, point.point.y, point.point.z, point.header.frame_id) == (1.0, 2.0, 3.0, "tam_array")
    matrix = std_msgs.Float64MultiArray(data=[0.0] * 9)
    written = MessageWriter(matrix, 9).message(b"", doubles[:9].tobytes())
    assert deserialize_message(written, std_msgs.Float64MultiArray).data.tolist() == doubles[:9].tolist()
