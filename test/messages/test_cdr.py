"""Serialised messages are read and filled in as rosbags, which builds objects, does."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from tam_calibration.messages.cdr import (
    BODY,
    FRAME_ID,
    NO_TIME,
    RawMessages,
    fill,
    read_frame_id,
    read_stamp_and_doubles,
    unpack_from,
)
from tam_calibration.messages.message_fields import MessageFields
from tam_calibration.model.exceptions import InputError

STORE = get_typestore(Stores.ROS2_JAZZY)
FIELD = "sensor_msgs/msg/MagneticField"


def field(frame_id):
    """Make a MagneticField of rosbags."""
    types = STORE.types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](17, 999_999_999), frame_id)
    return types[FIELD](header, types["geometry_msgs/msg/Vector3"](1.0, -2.0, 3e-5), np.arange(9.0))


def read_field(messages, count=3):
    """Return stamps and the first numbers of many messages MagneticField, (n, count)."""
    paths = [*(f"magnetic_field.{axis}" for axis in "xyz"), *(f"magnetic_field_covariance[{i}]" for i in range(9))]
    return MessageFields(STORE.fielddefs, FIELD).read(messages, paths[:count])


def read_float64s(messages):
    """Return the numbers of many messages Float64, (n, 1), and no stamps."""
    return MessageFields(STORE.fielddefs, "std_msgs/msg/Float64").read(messages, ["data"])


FRAMES = ["", "a", "abc", "abcd", "abcdefg", "abcdefgh", "Ångström"]


def blocks(messages):
    """Return messages in a block in which they begin at odd places."""
    joined = RawMessages.of([0] * (len(messages) + 1), [0] * (len(messages) + 1), [b"odd", *messages])
    return joined.take(slice(1, None))


@pytest.mark.parametrize("little_endian", [True, False])
@pytest.mark.parametrize("frame_id", FRAMES)
def test_stamp_and_numbers_are_read(frame_id, little_endian):
    """Whatever the frame's name, whose length moves the numbers, and the byte order."""
    message = STORE.serialize_cdr(field(frame_id), FIELD, little_endian=little_endian)
    stamps, values = read_field(blocks([message] * 3), 4)
    assert stamps.tolist() == [17_999_999_999] * 3
    assert values.tolist() == [[1.0, -2.0, 3e-5, 0.0]] * 3


def test_messages_of_many_frames_and_byte_orders_are_read_together():
    """A block may hold messages of any length and byte order, each keeps its place."""
    kinds = [(frame_id, little_endian) for frame_id in FRAMES for little_endian in (True, False)]
    messages = [STORE.serialize_cdr(field(frame), FIELD, little_endian=little) for frame, little in kinds]
    _, values = read_field(blocks(messages), 12)
    assert values.tolist() == [[1.0, -2.0, 3e-5, *range(9)]] * len(kinds)


@pytest.mark.parametrize("little_endian", [True, False])
def test_numbers_without_stamp_are_read(little_endian):
    """std_msgs/Float64 has no header."""
    name = "std_msgs/msg/Float64"
    messages = [
        STORE.serialize_cdr(STORE.types[name](value), name, little_endian=little_endian) for value in (4.5, -1.0)
    ]
    stamps, values = read_float64s(blocks(messages))
    assert stamps is None and values.tolist() == [[4.5], [-1.0]]


@pytest.mark.parametrize("message", [b"", b"\x00\x01\x00\x00", b"\x00\x07\x00\x00" + bytes(100)])
def test_other_messages_are_refused(message):
    """What is too short or serialised otherwise is not read as numbers, also among others."""
    good = bytes(STORE.serialize_cdr(field("frame"), FIELD))
    for read in (lambda messages: read_field(messages, 3), read_float64s):
        for messages in ([message], [good, message, good]):
            with pytest.raises(InputError, match="a message is damaged"):
                read(blocks(messages))


def test_a_name_that_reaches_beyond_the_message_is_refused():
    """A damaged length of the frame's name does not lead into the next message."""
    message = bytearray(STORE.serialize_cdr(field("frame"), FIELD))
    message[12:16] = (2**32 - 1).to_bytes(4, "little")
    with pytest.raises(InputError, match="a message is damaged"):
        read_field(blocks([bytes(message)] * 2), 3)


def test_copies_have_their_own_stamps_and_numbers():
    """Filled copies are what rosbags reads with these stamps and numbers; the rest stays."""
    template = STORE.serialize_cdr(field("frame"), FIELD)
    stamps_ns = np.array([1, 1_700_000_000_123_456_789])
    values = np.array([[1.0, 2.0, 3.0], [4.0, np.nan, 6.0]])
    for message, stamp_ns, row in zip(fill(template, 96, values, stamps_ns), stamps_ns, values, strict=True):
        read = STORE.deserialize_cdr(message.tobytes(), FIELD)
        assert read.header.stamp.sec * 10**9 + read.header.stamp.nanosec == stamp_ns
        assert read.header.frame_id == "frame"
        np.testing.assert_array_equal([read.magnetic_field.x, read.magnetic_field.y, read.magnetic_field.z], row)
        assert read.magnetic_field_covariance.tolist() == list(range(9))


@settings(max_examples=100, deadline=None)
@given(
    frame_id=st.text(max_size=20),
    vector=st.tuples(*[st.floats(allow_nan=False)] * 3),
    little_endian=st.booleans(),
    length=st.integers(0, 120),
)
def test_one_message_is_read_as_many_are(frame_id, vector, little_endian, length):
    """A message by itself gives the numbers that it gives in a block, and is refused where that is."""
    message = field(frame_id.replace("\0", ""))
    message.magnetic_field.x, message.magnetic_field.y, message.magnetic_field.z = vector
    whole = bytes(STORE.serialize_cdr(message, FIELD, little_endian=little_endian))
    stamp_ns, values = read_stamp_and_doubles(whole, 3)
    stamps, rows = read_field(RawMessages.of([0], [0], [whole]), 3)
    assert (stamp_ns, values) == (stamps[0], tuple(rows[0].tolist())) == (17_999_999_999, vector)
    part = RawMessages.of([0], [0], [whole[:length]])
    try:
        read_field(part, 3)
    except InputError:
        with pytest.raises(InputError, match="a message is damaged"):
            read_stamp_and_doubles(whole[:length], 3)
    else:
        read_stamp_and_doubles(whole[:length], 3)


@pytest.mark.parametrize("little_endian", [True, False])
def test_one_number_without_stamp_is_read(little_endian):
    """A message std_msgs/Float64 by itself; a damaged one is refused."""
    name = "std_msgs/msg/Float64"
    message = bytes(STORE.serialize_cdr(STORE.types[name](-4.5), name, little_endian=little_endian))
    assert unpack_from(message, "d", BODY) == (-4.5,)
    for bad in (message[:-1], b"", bytes(100)[:2] + b"x", b"\7\7" + message[2:]):
        with pytest.raises(InputError, match="damaged"):
            unpack_from(bad, "d", BODY)


@pytest.mark.parametrize("stamp", [(-1, 0), (-(2**31), 5), (0, 10**9), (2**31 - 1, 2**32 - 1)])
def test_a_stamp_that_is_no_time_is_none(stamp):
    """Before 1970, or with a second of nanoseconds: one message is refused, among many it is marked."""
    message = bytearray(STORE.serialize_cdr(field("frame"), FIELD))
    good = bytes(message)
    message[4:12] = stamp[0].to_bytes(4, "little", signed=True) + stamp[1].to_bytes(4, "little")
    with pytest.raises(InputError, match="the stamp is no time"):
        read_stamp_and_doubles(bytes(message), 3)
    stamps, _ = read_field(blocks([good, bytes(message), good]), 3)
    assert stamps.tolist() == [17_999_999_999, NO_TIME, 17_999_999_999]


def test_the_latest_stamp_is_a_time():
    """The last nanosecond of the type."""
    message = bytearray(STORE.serialize_cdr(field("frame"), FIELD))
    message[4:12] = (2**31 - 1).to_bytes(4, "little") + (10**9 - 1).to_bytes(4, "little")
    assert read_stamp_and_doubles(bytes(message), 3)[0] == 2**31 * 10**9 - 1


@pytest.mark.parametrize("is_little_endian", [True, False])
@pytest.mark.parametrize("name", ["", "tam_1_link", "é"])
def test_the_name_of_a_frame_is_read(name, is_little_endian):
    """From the header of a message as rosbags writes it; a message that ends before it is damaged."""
    message = bytes(STORE.serialize_cdr(field(name), FIELD, little_endian=is_little_endian))
    assert read_frame_id(message) == name
    assert message.startswith(f"{name}\0".encode(), FRAME_ID)
    with pytest.raises(InputError, match="damaged"):
        read_frame_id(message[:10])
