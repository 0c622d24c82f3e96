"""Markers, read as rosbags reads them: where what they show is, and how large."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tam_calibration.fit.coverage import measure_coverage
from tam_calibration.localization.solutions import EulerSolutions, ellipsoid

pytest.importorskip("visualization_msgs.msg", reason="the ROS message packages are not installed")

STORE = get_typestore(Stores.ROS2_JAZZY)


def header():
    """Return a header."""
    from rclpy.time import Time
    from std_msgs.msg import Header

    return Header(stamp=Time(nanoseconds=1_700_000_000_123_456_789).to_msg(), frame_id="level")


def read(message, name="visualization_msgs/msg/MarkerArray"):
    """Return a message as rosbags reads it, after a look at the headers of its markers."""
    from rclpy.serialization import serialize_message

    told = STORE.deserialize_cdr(serialize_message(message), name)
    for marker in getattr(told, "markers", [told]):
        stamp = marker.header.stamp
        assert (stamp.sec, stamp.nanosec, marker.header.frame_id) == (1_700_000_000, 123_456_789, "level")
    return told


def numbers(vector):
    """Return x, y and z."""
    return [vector.x, vector.y, vector.z]


def source(moment):
    """Return a located source."""
    root = np.array([[0.1, 0.02, 0], [0, 0.3, -0.04], [0.01, 0, 0.05]])
    covariance = (root @ root.T)[None]
    return EulerSolutions(
        np.array([[3.0, 4.0, 0.0]]), covariance, np.array([moment], dtype=float), covariance, np.zeros(1, dtype=int)
    )


def test_a_source_is_an_ellipsoid_and_an_arrow():
    """Diameters and orientation are those of the covariance; the arrow is half as long as the source is far."""
    from tam_calibration.nodes.markers import source_markers

    solutions = source([0.0, -8.0, 0.0])
    ball, arrow = read(source_markers(header(), solutions, 0)).markers
    assert (ball.type, arrow.type) == (ball.SPHERE, arrow.ARROW) and ball.ns != arrow.ns
    assert numbers(ball.pose.position) == [3, 4, 0]
    semi_axes, _ = ellipsoid(solutions.position_covariance_m2[0])
    assert_allclose(numbers(ball.scale), 2 * semi_axes)
    turn = ball.pose.orientation
    axes = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
    variances = np.diag(axes.T @ solutions.position_covariance_m2[0] @ axes)
    assert_allclose(semi_axes**2 / variances, 7.814727903251179)
    assert_allclose([numbers(point) for point in arrow.points], [[3, 4, 0], [3, 1.5, 0]])
    assert ball.lifetime.sec == 2


def test_a_source_without_moment_has_no_arrow():
    """As of a structural index other than that of a dipole."""
    from tam_calibration.nodes.markers import source_markers

    assert len(read(source_markers(header(), source([np.nan] * 3), 0)).markers) == 1


def test_the_field_is_an_arrow_from_the_centre():
    """Half a metre long in the field of the Earth."""
    from tam_calibration.nodes.markers import field_marker

    arrow = read(field_marker(header(), np.array([30e-6, 0, -40e-6])), "visualization_msgs/msg/Marker")
    assert_allclose([numbers(point) for point in arrow.points], [[0, 0, 0], [0.3, 0, -0.4]], atol=1e-15)
    assert_allclose(numbers(arrow.scale), [0.025, 0.05, 0.1])


def test_the_cells_of_the_coverage_are_covered_or_missing():
    """Each of the 200 is in one of two lists, on a sphere of one metre; a list that is empty takes away the last."""
    from tam_calibration.nodes.markers import coverage_markers

    rng = np.random.default_rng(2)
    fields = rng.normal(size=(20_000, 3))
    half = measure_coverage(fields * np.where(fields[:, 2:] < 0, -1, 1) * 5e-5)
    covered, missing = read(coverage_markers(header(), half)).markers
    assert (covered.ns, missing.ns, len(covered.points), len(missing.points)) == ("covered", "missing", 100, 100)
    assert all(point.z > 0 for point in covered.points) and all(point.z < 0 for point in missing.points)
    assert_allclose(np.linalg.norm([numbers(point) for point in covered.points], axis=1), 1)
    assert numbers(covered.scale) == [0.15] * 3
    whole = read(coverage_markers(header(), measure_coverage(fields))).markers
    assert [each.action for each in whole] == [covered.ADD, covered.DELETE]


def test_what_is_shown_is_rare(bench, monkeypatch):
    """Nobody listens: nothing is wanted; else a message every tenth of a second."""
    from visualization_msgs.msg import Marker

    from tam_calibration.nodes import markers

    class Node:
        offer = staticmethod(bench.node.create_publisher)

    now = [100.0]
    monkeypatch.setattr(markers.time, "monotonic", lambda: now[0])
    shown = markers.Shown(Node, Marker, "center_marker", "tam_array")
    assert not shown.is_wanted()
    monkeypatch.setattr(shown.publisher, "get_subscription_count", lambda: 1)
    assert [shown.is_wanted(), shown.is_wanted()] == [True, False]
    for step, expected in ((0.09, False), (0.02, True), (0.09, False)):
        now[0] += step
        assert shown.is_wanted() is expected
