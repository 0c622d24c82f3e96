"""Serialised clouds and other messages: written from templates, read many at once."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

COLUMNS = ("time_s", "b1x_T", "gxx_standard_error")
OTHER = ("a", "bc")
STAMP_NS = 1_700_000_000_123_456_789


def read(messages):
    """Return columns, stamp and values of each row that a reader gives, and what it refuses."""
    from tam_calibration.nodes.cloud import CloudReader, from_stamp

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

    from tam_calibration.nodes.cloud import make_cloud

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

    from tam_calibration.nodes.cloud import cloud_writer, read_cloud, to_stamp

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

    from tam_calibration.nodes.cloud import MessageWriter, to_stamp

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
