"""Transforms of tf: read as rosbags writes them, and put together as tf2 does."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tam_calibration.messages.cdr import TransformTree, read_transforms
from tam_calibration.model.exceptions import InputError

STORE = get_typestore(Stores.ROS2_JAZZY)
TREE = [
    ("base_link", "tam_array", [1.0, 0.0, -0.2], [180, 0, 90]),
    ("tam_array", "arm", [0.25, 0.0, 0.0], [0, 0, 90]),
    ("arm", "tam_1_link", [0.0, 0.5, 0.0], [90, 0, 0]),
    ("base_link", "imu_link", [0.0, 0.1, 0.0], [0, 30, 0]),
]
"""Parent, child, position in metres, roll, pitch and yaw in degrees."""


def serialised(transforms, is_little_endian=True):
    """Return a serialised TFMessage as rosbags makes it."""

    def make(name, *values):
        return STORE.types[name](*values)

    def stamped(parent, child, position, angles):
        time = make("builtin_interfaces/msg/Time", 12, 34)
        turn = make("geometry_msgs/msg/Quaternion", *Rotation.from_euler("xyz", angles, degrees=True).as_quat())
        transform = make("geometry_msgs/msg/Transform", make("geometry_msgs/msg/Vector3", *position), turn)
        return make("geometry_msgs/msg/TransformStamped", make("std_msgs/msg/Header", time, parent), child, transform)

    message = make("tf2_msgs/msg/TFMessage", [stamped(*each) for each in transforms])
    return bytes(STORE.serialize_cdr(message, message.__msgtype__, little_endian=is_little_endian))


def tree_of(*messages):
    """Return the tree of serialised messages."""
    tree = TransformTree()
    for message in messages:
        tree.add(message)
    return tree


@pytest.mark.parametrize("is_little_endian", [True, False])
def test_a_message_is_read(is_little_endian):
    """Names of any length and numbers, in either byte order."""
    read = read_transforms(serialised(TREE, is_little_endian))
    assert [(each.parent, each.child, each.position_m.tolist()) for each in read] == [each[:3] for each in TREE]
    angles = [Rotation.from_quat(each.rotation).as_euler("xyz", degrees=True) for each in read]
    assert_allclose(angles, [each[3] for each in TREE], atol=1e-12)


def matrix(position, angles):
    """Return the (4, 4) matrix from a frame to its parent."""
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = Rotation.from_euler("xyz", angles, degrees=True).as_matrix(), position
    return whole


def test_frames_are_found_over_others():
    """Up to a common ancestor and down again, whatever messages the transforms came in."""
    tree = tree_of(serialised(TREE[2:]), serialised(TREE[:1]), serialised(TREE[1:2]))
    array, arm, sensor, imu = (matrix(*each[2:]) for each in TREE)
    for frame, expected in (("tam_1_link", arm @ sensor), ("/imu_link", np.linalg.inv(array) @ imu)):
        position, rotation = tree.pose(frame, "tam_array")
        assert_allclose(position, expected[:3, 3], atol=1e-15)
        assert_allclose(Rotation.from_quat(rotation).as_matrix(), expected[:3, :3], atol=1e-15)


def test_a_later_transform_replaces_the_earlier():
    """Of the same frame, as in tf2."""
    moved = ("tam_array", "arm", [9.0, 0.0, 0.0], [0, 0, 0])
    position, _ = tree_of(serialised(TREE), serialised([moved])).pose("arm", "tam_array")
    assert position.tolist() == [9, 0, 0]


def test_frames_without_a_chain_are_not_found():
    """Neither a frame that is nowhere, nor one of another tree; the array's own frame is where it is."""
    tree = tree_of(serialised(TREE[1:3]))
    assert tree.pose("tam_2_link", "tam_array") is None
    assert tree.pose("arm", "base_link") is None
    assert tree.pose("tam_array", "/tam_array")[0].tolist() == [0, 0, 0]


def test_a_circle_is_refused():
    """It would be followed for ever."""
    circle = tree_of(serialised([("a", "b", [0, 0, 0], [0, 0, 0]), ("b", "a", [0, 0, 0], [0, 0, 0])]))
    with pytest.raises(InputError, match="lead from a back to a"):
        circle.pose("a", "tam_array")


def test_a_damaged_message_is_refused():
    """At whatever byte it ends."""
    message = serialised(TREE[:1])
    for end in range(0, len(message) - 8, 7):
        with pytest.raises(InputError, match="damaged"):
            read_transforms(message[:end])


def test_a_quaternion_of_zeros_is_refused():
    """tf2 holds any numbers."""
    message = serialised([("tam_array", "arm", [0, 0, 0], [0, 0, 0])])
    with pytest.raises(InputError, match="the rotation of arm in tam_array is not a valid one"):
        tree_of(message[:-8] + bytes(8)).pose("arm", "tam_array")
