"""Positions of a platform from tables and bags: metres east, north and up, and one sentence where they cannot be."""

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from tam_calibration import InputError, Recording, read_recording
from tam_calibration.messages.samples import Samples
from tam_calibration.recordings.fit_input import RecordingStream
from tam_calibration.recordings.intake import east_north_up, geographic

STORE = get_typestore(Stores.ROS2_JAZZY)
COUNT = 60
TIME_S = 100.0 + 0.1 * np.arange(COUNT)
PLACES_M = np.column_stack([0.1 * np.arange(COUNT), np.sin(np.arange(COUNT)), -5.0 * np.ones(COUNT)])


def readings_T():
    """Return readings of four sensors that are turned in the Earth's field."""
    directions = np.random.default_rng(1).normal(size=(COUNT, 1, 3))
    return np.repeat(50e-6 * directions / np.linalg.norm(directions, axis=2, keepdims=True), 4, axis=1)


def write_table(path, columns, cells):
    """Write readings with further columns."""
    names = ["time_s", *(f"b{sensor}{axis}_T" for sensor in range(1, 5) for axis in "xyz"), *columns]
    rows = np.column_stack([TIME_S, readings_T().reshape(COUNT, -1), cells])
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="", fmt="%.15g")
    return path


def test_local_columns_are_read_and_kept_by_slices_thinning_and_streams(tmp_path):
    """x_m, y_m and z_m are the position, which every selection of samples keeps with its samples."""
    path = write_table(tmp_path / "line.csv", ("x_m", "y_m", "z_m"), PLACES_M)
    recording = read_recording(path)
    assert recording.position_m == pytest.approx(PLACES_M)
    assert recording.take(slice(5, 9)).position_m == pytest.approx(PLACES_M[5:9])
    assert recording.thinned(20).position_m == pytest.approx(PLACES_M[::3])
    assert read_recording(path, start=1.0).position_m[0] == pytest.approx(PLACES_M[10])
    stream = RecordingStream([Samples(recording.take(slice(0, 20))), Samples(recording.take(slice(20, None)))])
    assert stream.whole().position_m == pytest.approx(PLACES_M)
    assert Recording.from_pandas(recording.to_pandas()).position_m == pytest.approx(PLACES_M)
    assert np.array_equal(Recording.from_xarray(recording.to_xarray()).position_m, recording.position_m)


def test_geographic_columns_count_from_the_first(tmp_path):
    """A minute of latitude is 1853 m at 47.8° north (WGS 84), and depth is down."""
    cells = np.column_stack([47.8 + np.arange(COUNT) / 60 / COUNT, np.full(COUNT, 8.5), np.full(COUNT, 4.0)])
    cells[3:, 2] += 2.0
    position_m = read_recording(write_table(tmp_path / "line.csv", ("lat_deg", "lon_deg", "depth_m"), cells)).position_m
    assert position_m[0] == pytest.approx([0, 0, 0])
    assert position_m[-1, 1] == pytest.approx(1853.0 * (COUNT - 1) / COUNT, rel=1e-3)
    assert position_m[3, 2] == pytest.approx(-2.0, abs=1e-3)


def test_the_tangent_plane_is_that_of_the_ellipsoid():
    """A degree of longitude at the equator is π/180 of the equatorial radius, and height is up."""
    places = np.array([[0.0, 1e-3, 0.0], [0.0, 0.0, 7.0]])
    local = east_north_up(places, np.zeros(3))
    assert local[0] == pytest.approx([6_378_137.0 * np.radians(1e-3), 0, 0], abs=1e-3)
    assert local[1] == pytest.approx([0, 0, 7.0])


@pytest.mark.parametrize(
    ("columns", "cells", "sentence"),
    [
        (("x_m", "y_m"), PLACES_M[:, :2], "column z_m is missing"),
        (("lat_deg", "lon_deg", "depth_m"), 500.0 + PLACES_M, "latitude of 500"),
        (("x_m", "y_m", "z_m", "lat_deg", "lon_deg", "depth_m"), np.tile(PLACES_M, 2), "there twice"),
    ],
)
def test_columns_that_are_no_position_are_one_sentence(tmp_path, columns, cells, sentence):
    """What is missing, twice or impossible is named."""
    with pytest.raises(InputError, match=sentence):
        read_recording(write_table(tmp_path / "line.csv", columns, cells))


def message_of(kind, stamp, place):
    """Return a message of navigation."""
    types = STORE.types
    seconds, nanoseconds = divmod(round(1e9 * stamp), 1_000_000_000)
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](seconds, nanoseconds), "map")
    if kind == "sensor_msgs/msg/NavSatFix":
        status = types["sensor_msgs/msg/NavSatStatus"](0, 0)
        return types[kind](header, status, *place, np.zeros(9), 0)
    turn = types["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    pose = types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*place), turn)
    stated = types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36))
    if kind == "geometry_msgs/msg/PoseWithCovarianceStamped":
        return types[kind](header, stated)
    zero = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    speed = types["geometry_msgs/msg/TwistWithCovariance"](types["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36))
    return types[kind](header, "base_link", stated, speed)


@pytest.mark.parametrize(
    "kind",
    ["nav_msgs/msg/Odometry", "geometry_msgs/msg/PoseWithCovarianceStamped", "sensor_msgs/msg/NavSatFix"],
)
def test_a_map_names_a_topic_of_navigation(tmp_path, kind):
    """The types of ROS that hold a position need no more than their topic."""
    is_geographic = kind.endswith("NavSatFix")
    places = [47.8, 8.5, 0.0] + 1e-5 * PLACES_M if is_geographic else PLACES_M
    field = "sensor_msgs/msg/MagneticField"
    with Writer(tmp_path / "bag", version=9) as writer:
        sensors = [writer.add_connection(f"/mag{number}", field, typestore=STORE) for number in range(4)]
        odometry = writer.add_connection("/odom", kind, typestore=STORE)
        for stamp, place, readings in zip(TIME_S, places, readings_T(), strict=True):
            stamp_ns = round(1e9 * stamp)
            moved = message_of(kind, stamp, place)
            writer.write(odometry, stamp_ns, STORE.serialize_cdr(moved, kind))
            for sensor, reading in zip(sensors, readings, strict=True):
                vector = STORE.types["geometry_msgs/msg/Vector3"](*reading)
                sent = STORE.types[field](moved.header, vector, np.zeros(9))
                writer.write(sensor, stamp_ns, STORE.serialize_cdr(sent, field))
    channels = {"sensors": [{"topic": f"/mag{number}"} for number in range(4)], "position": {"topic": "/odom"}}
    recording = read_recording(tmp_path / "bag", map=channels)
    expected = east_north_up(places, places[0]) if is_geographic else PLACES_M
    assert recording.position_m == pytest.approx(expected, abs=1e-6)


def test_geographic_positions_are_the_inverse_of_local_ones():
    """To a micrometre and 1e-11 degrees, kilometres from the origin."""
    origin = np.array([54.3, 10.1, 20.0])
    local = np.array([[0.0, 0.0, 0.0], [3000.0, -4000.0, -30.0], [-20.0, 10.0, -5.0]])
    places = geographic(local, origin)
    np.testing.assert_allclose(east_north_up(places, origin), local, atol=1e-6)
    np.testing.assert_allclose(places[0], origin)
