"""Serialised messages are read and filled in as rosbags, which builds objects, does."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tam_calibration.files.cdr import StampedDoubles, fill, read_float64
from tam_calibration.problems import InputError

STORE = get_typestore(Stores.ROS2_JAZZY)
FIELD = "sensor_msgs/msg/MagneticField"


def field(frame_id):
    """Make a MagneticField of rosbags."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](17, 999_999_999), frame_id)
    return types[FIELD](header, types["geometry_msgs/msg/Vector3"](1.0, -2.0, 3e-5), np.arange(9.0))


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("frame_id", ["", "a", "abc", "abcd", "abcdefg", "abcdefgh", "Ångström"])
def test_stamp_and_numbers_are_read(frame_id, little_endian):
    """Whatever the frame's name, whose length moves the numbers, and the byte order."""
    message = STORE.serialize_cdr(field(frame_id), FIELD, little_endian=little_endian)
    assert StampedDoubles(4).read(message) == (17_999_999_999, (1.0, -2.0, 3e-5, 0.0))


def test_a_number_without_stamp_is_read():
    """std_msgs/Float64 has no header."""
    message = STORE.serialize_cdr(STORE.types["std_msgs/msg/Float64"](4.5), "std_msgs/msg/Float64")
    assert read_float64(message) == (None, (4.5,))


@pytest.mark.parametrize("message", [b"", b"\x00\x01\x00\x00", b"\x00\x07\x00\x00" + bytes(100)])
def test_other_messages_are_refused(message):
    """What is too short or serialised otherwise is not read as numbers."""
    for read in (StampedDoubles(3).read, read_float64):
        with pytest.raises(InputError, match="a message is damaged"):
            read(message)


def test_copies_have_their_own_stamps_and_numbers():
    """Filled copies are what rosbags reads with these stamps and numbers; the rest stays."""
    template = STORE.serialize_cdr(field("frame"), FIELD)
    stamps_ns = np.array([1, 1_700_000_000_123_456_789])
    values = np.array([[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]])
    for message, stamp_ns, row in zip(fill(template, 96, values, stamps_ns), stamps_ns, values, strict=True):
        read = STORE.deserialize_cdr(message, FIELD)
        assert read.header.stamp.sec * 10**9 + read.header.stamp.nanosec == stamp_ns
        assert read.header.frame_id == "frame"
        np.testing.assert_array_equal([read.magnetic_field.x, read.magnetic_field.y, read.magnetic_field.z], row)
        assert read.magnetic_field_covariance.tolist() == list(range(9))
