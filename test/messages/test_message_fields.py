"""Numbers inside serialised messages of any type are those that rosbags deserialises."""

import re
from functools import reduce

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from tam_calibration.messages.cdr import RawMessages
from tam_calibration.messages.message_fields import MessageFields, stamp_fields
from tam_calibration.model.exceptions import InputError

CUSTOM = "lab_msgs/msg/Array"
DEFINITION = """
uint8 MAX_SENSORS=4
std_msgs/Header header
string serial
bool is_locked
Reading[] readings
uint16[] counts
geometry_msgs/Vector3 mag
int8[3] state
string[] notes
float32 temperature
uint64 ticks
================================================================================
MSG: lab_msgs/Reading
string name
float64 value
"""
"""Strings, lists of structures and numbers of all sizes before a vector, which stands elsewhere in each message."""

KINDS = {
    "sensor_msgs/msg/MagneticField": ("magnetic_field.x", "magnetic_field.z", "magnetic_field_covariance[8]"),
    "sensor_msgs/msg/Imu": ("orientation.w", "angular_velocity.y", "linear_acceleration_covariance[8]"),
    "geometry_msgs/msg/Vector3Stamped": ("vector.x", "vector.y", "vector.z"),
    "std_msgs/msg/Float32MultiArray": ("layout.data_offset", "data[0]", "data[11]"),
    CUSTOM: ("mag.x", "mag.z", "is_locked", "state[1]", "temperature", "ticks"),
}
"""Paths that are read of each type."""

HEADED = {kind for kind in KINDS if kind != "std_msgs/msg/Float32MultiArray"}


def store_of(is_ros1):
    """Return a store of ROS 1 or 2 that knows the custom type."""
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(DEFINITION, CUSTOM))
    return store


STORES = {is_ros1: store_of(is_ros1) for is_ros1 in (False, True)}

BYTES = {"byte": "u1", "char": "u1", "octet": "u1"}
"""Names of numbers that numpy names otherwise."""


def made(store, kind, rng):
    """Return a message of a type of random content, with strings and lists of any length."""
    return store.types[kind](*(value_of(store, each, rng) for _, each in store.fielddefs[kind][1]))


def value_of(store, definition, rng):
    """Return a random value of a field."""
    tag, argument = definition
    if tag == 2:
        return made(store, argument, rng)
    if tag == 1:
        return base(argument[0], rng, ())[()]
    (inner, name), count = argument
    count = count if tag == 3 else 12 if name[0] == "float32" else int(rng.integers(0, 5))
    return base(name[0], rng, (count,)) if inner == 1 else [made(store, name, rng) for _ in range(count)]


def base(name, rng, shape):
    """Return random numbers or words of a type."""
    if name == "string":
        words = ["".join(rng.choice(list("abc "), rng.integers(0, 9))) for _ in range(int(np.prod(shape, dtype=int)))]
        return words if shape else np.array(words[0], dtype=object)
    kind = np.dtype(BYTES.get(name, name))
    if kind.kind == "f":
        return rng.normal(size=shape).astype(kind)
    return rng.integers(0, 2 if kind.kind == "b" else 100, shape).astype(kind)


def serialised(store, is_ros1, message, kind, little_endian=True):
    """Return the bytes of a message."""
    if is_ros1:
        return bytes(store.serialize_ros1(message, kind))
    return bytes(store.serialize_cdr(message, kind, little_endian=little_endian))


def at(message, path):
    """Return the number at a path of a message of rosbags."""
    parts = re.findall(r"\w+", path)
    return float(
        reduce(lambda value, part: value[int(part)] if part.isdigit() else getattr(value, part), parts, message)
    )


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("is_ros1", "little_endian"), [(True, True), (False, True), (False, False)])
def test_numbers_are_those_of_rosbags(kind, is_ros1, little_endian):
    """Stamps and numbers of many messages at once, of ROS 1, and of ROS 2 in both byte orders."""
    rng, store = np.random.default_rng(4), STORES[is_ros1]
    messages = [made(store, kind, rng) for _ in range(50)]
    raw = [serialised(store, is_ros1, each, kind, little_endian) for each in messages]
    fields = MessageFields(store.fielddefs, kind, is_ros1)
    stamps_ns, values = fields.read(RawMessages.of([0] * 50, [0] * 50, raw), KINDS[kind])
    read = store.deserialize_ros1 if is_ros1 else store.deserialize_cdr
    expected = [read(each, kind) for each in raw]
    assert_array_equal(values, [[at(each, path) for path in KINDS[kind]] for each in expected])
    if kind in HEADED:
        stamps = [each.header.stamp for each in expected]
        assert stamps_ns.tolist() == [stamp.sec * 10**9 + stamp.nanosec for stamp in stamps]
    else:
        assert stamps_ns is None


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 9), st.booleans())
def test_any_message_of_a_custom_type_is_read(seed, count, is_ros1):
    """Whatever stands before a field: words and lists of any length, in a block with other bytes before and behind."""
    rng, store = np.random.default_rng(seed), STORES[is_ros1]
    messages = [made(store, CUSTOM, rng) for _ in range(count)]
    raw = [serialised(store, is_ros1, each, CUSTOM) for each in messages]
    odd = [piece for each in raw for piece in (rng.bytes(int(rng.integers(0, 7))), each)]
    chosen = RawMessages.of([0] * len(odd), [0] * len(odd), odd).take(slice(1, None, 2))
    values = MessageFields(store.fielddefs, CUSTOM, is_ros1).read(chosen, ["mag.y", "temperature", "ticks"])[1]
    assert_array_equal(values, [[at(each, path) for path in ("mag.y", "temperature", "ticks")] for each in messages])


def test_a_list_that_is_shorter_gives_nan():
    """In the messages in which the place is missing; the others have their numbers."""
    kind, store = "std_msgs/msg/Float32MultiArray", STORES[False]
    layout = store.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    lists = [np.arange(length, dtype=np.float32) for length in (3, 0, 5)]
    raw = [serialised(store, False, store.types[kind](layout, each), kind) for each in lists]
    messages = RawMessages.of([0] * 3, [0] * 3, raw)
    fields = MessageFields(store.fielddefs, kind)
    assert_array_equal(fields.read(messages, ["data[0]", "data[4]"])[1], [[0, np.nan], [np.nan, np.nan], [0, 4]])
    assert not [path for path in fields.expanded(messages) if path.startswith("data")]
    assert fields.expanded(messages.take(slice(1)))[-3:] == ("data[0]", "data[1]", "data[2]")


def test_bytes_of_clouds_and_images_are_no_numbers():
    """Their lists are not offered as readings; their other numbers are."""
    for kind, known in (("sensor_msgs/msg/PointCloud2", "point_step"), ("sensor_msgs/msg/Image", "width")):
        paths = MessageFields(STORES[False].fielddefs, kind).paths
        assert known in paths and not [path for path in paths if path.startswith("data")]


@pytest.mark.parametrize("kind", KINDS)
def test_a_message_that_is_cut_is_refused(kind):
    """Wherever it ends before the last number that is wanted; no byte of the next is taken for its own."""
    store, rng = STORES[False], np.random.default_rng(1)
    whole = serialised(store, False, made(store, kind, rng), kind)
    fields, path = MessageFields(store.fielddefs, kind), KINDS[kind][-1]
    for length in {*range(0, 12), len(whole) // 2}:
        with pytest.raises(InputError, match=r"shorter than its type says|no plain CDR"):
            fields.read(RawMessages.of([0, 0], [0, 0], [whole[:length], whole]), [path])


@settings(deadline=None, max_examples=60)
@given(st.binary(max_size=200), st.sampled_from(list(KINDS)), st.booleans())
def test_rubbish_is_refused_or_read(content, kind, is_ros1):
    """Bytes of any kind never end in anything but numbers or one sentence."""
    fields = MessageFields(STORES[is_ros1].fielddefs, kind, is_ros1)
    try:
        values = fields.read(RawMessages.of([0], [0], [content]), KINDS[kind])[1]
    except InputError as problem:
        assert "\n" not in str(problem)
    else:
        assert values.shape == (1, len(KINDS[kind]))


@pytest.mark.parametrize(
    ("kind", "paths", "expected"),
    [
        ("a/msg/B", ("header.stamp.sec", "header.stamp.nanosec", "x"), ("header.stamp.sec", "header.stamp.nanosec")),
        ("a/msg/B", ("stamp.sec", "stamp.nanosec"), ("stamp.sec", "stamp.nanosec")),
        ("px4_msgs/msg/SensorMag", ("timestamp", "x"), ("timestamp",)),
        ("a/msg/B", ("timestamp", "x"), ()),
    ],
)
def test_where_a_stamp_stands(kind, paths, expected):
    """In a header, in a stamp beside the numbers, or in the microseconds of PX4."""
    assert stamp_fields(kind, paths) == expected
