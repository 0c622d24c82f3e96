"""Sensors and an IMU that are turned against the array: processes over DDS whose samples are in the array's axes.

`tf2_msgs` is not among the packages that can be installed here. A stand-in is put in its place for the nodes: the type
on the topic has another name, the bytes are those of a TFMessage as rosbags writes it.
"""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.nodes.session import START
from tam_calibration.recordings import write_array
from tam_calibration.results import calibration_from_yaml

sensor_msgs = pytest.importorskip("sensor_msgs.msg", reason="the ROS message packages are not installed")
std_msgs = pytest.importorskip("std_msgs.msg", reason="the ROS message packages are not installed")

STORE = get_typestore(Stores.ROS2_JAZZY)
ANGLES_DEG = [[0, 0, 0], [0, 0, 90], [180, 0, 30], [10, -20, 130]]
ROTATIONS = Rotation.from_euler("xyz", ANGLES_DEG, degrees=True)
IMU = Rotation.from_euler("xyz", [5, 90, -30], degrees=True)
COUNT = 60


@pytest.fixture
def turned(passing, cross):
    """Return an array with turned sensors and IMU, and what its drivers would give for the recording of a pass."""
    array = replace(cross, mounting=Mounting(ROTATIONS.as_quat(), IMU.as_quat()))
    return array, array.mounting.inverse.turned(passing.take(slice(0, COUNT)))


def publish_imu(bench, frame_id=""):
    """Return a function that publishes the attitude of a sample of a recording."""
    from rclpy.time import Time

    publisher = bench.node.create_publisher(sensor_msgs.Imu, "imu/data", 1000)
    bench.spin_until(publisher.get_subscription_count, "the attitude is subscribed")

    def publish(recording, index):
        message = sensor_msgs.Imu()
        message.header.stamp = Time(nanoseconds=round(recording.time_s[index] * 1e9)).to_msg()
        message.header.frame_id = frame_id
        turn = message.orientation
        turn.x, turn.y, turn.z, turn.w = recording.attitude[index].tolist()
        publisher.publish(message)

    return publish


def play(bench, recording, imu_frame_id=""):
    """Play a recording to the collector and return the rows of `samples`."""
    from tam_calibration.nodes.topics import read_cloud

    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish_attitude = publish_imu(bench, imu_frame_id)
    publish_readings = bench.publish_sensors(scalar=False)
    bench.connect(collector={"samples": 1})

    def publish(recording, index):
        publish_attitude(recording, index)
        bench.spin_until(lambda: True, "at once")
        publish_readings(recording, index)

    bench.play(recording, publish, samples)
    return np.concatenate([read_cloud(cloud)[1] for cloud in samples])


def test_live_samples_have_the_bits_of_the_file(bench, turned, tmp_path):
    """Readings and attitude of turned drivers come into the array's axes as offline; a wrong frame is a warning."""
    array, drivers = turned
    frames = ("one", "two", "three", "four")
    path = tmp_path / "turned.yaml"
    write_array(path, replace(array, mounting=replace(array.mounting, frame_ids=frames, imu_frame_id="imu_link")))
    bench.start_nodes(collector={"array_file": path})
    rows = play(bench, drivers, "imu_link")
    expected = array.mounting.turned(drivers)
    assert_array_equal(rows[:, 1:13], expected.readings_T.reshape(COUNT, -1))
    known = np.isfinite(rows[:, -7:-3]).all(axis=1)
    assert known.sum() >= COUNT - 1
    taken = {tuple(each) for each in expected.attitude.tolist()}
    assert {tuple(each) for each in rows[known, -7:-3].tolist()} <= taken
    wrong = "the messages of tam_2 are of the frame without name, the array file says two"
    status, _ = bench.health("collector", lambda status, _: wrong in status.message, "the frame is told")
    assert status.level == b"\1" and "imu_link" not in status.message


def transforms_of(array, mounting):
    """Return serialised TFMessages: of the sensors by an arm each, and of the IMU with the vehicle's body."""

    def make(name, *values):
        return STORE.types[name](*values)

    def stamped(parent, child, position, rotation):
        turn = make("geometry_msgs/msg/Quaternion", *rotation.as_quat().tolist())
        transform = make("geometry_msgs/msg/Transform", make("geometry_msgs/msg/Vector3", *position), turn)
        header = make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", 0, 0), parent)
        return make("geometry_msgs/msg/TransformStamped", header, child, transform)

    def serialised(*transforms):
        return bytes(STORE.serialize_cdr(make("tf2_msgs/msg/TFMessage", list(transforms)), "tf2_msgs/msg/TFMessage"))

    body = Rotation.from_euler("xyz", [180, 0, 0], degrees=True)
    arms = [
        stamped("tam_array", f"arm_{sensor}", position, Rotation.identity())
        for sensor, position in enumerate(array.positions_m, 1)
    ]
    sensors = [
        stamped(f"arm_{sensor}", f"tam_{sensor}_link", [0, 0, 0], rotation)
        for sensor, rotation in enumerate(Rotation.from_quat(mounting.rotations), 1)
    ]
    imu = stamped("base_link", "imu_link", [0.1, 0, 0], body * Rotation.from_quat(mounting.imu_rotation))
    return serialised(*arms, *sensors), serialised(stamped("base_link", "tam_array", [1, 2, 3], body), imu)


def put_in_place_of_tf2_msgs(folder, monkeypatch):
    """Put a package of that name into the path of Python of the processes, with a type that carries any bytes."""
    (folder / "tf2_msgs").mkdir()
    (folder / "tf2_msgs" / "__init__.py").touch()
    (folder / "tf2_msgs" / "msg.py").write_text("from std_msgs.msg import String as TFMessage\n")
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
    monkeypatch.syspath_prepend(folder)


def publish_transforms(bench, messages):
    """Publish serialised TFMessages as static broadcasters do, each with one of its own."""
    from tam_calibration.nodes.topics import LATCHED

    for message in messages:
        bench.node.create_publisher(std_msgs.String, "/tf_static", LATCHED).publish(message)


def test_tf_tells_what_the_array_file_leaves_to_it(bench, turned, recording, tmp_path, monkeypatch):
    """Positions and rotations come over several frames and publishers; the calibration holds them."""
    array, _ = turned
    put_in_place_of_tf2_msgs(tmp_path, monkeypatch)
    path = tmp_path / "frames.yaml"
    frames = "frame_ids: [tam_1_link, tam_2_link, tam_3_link, tam_4_link]\nimu_frame_id: imu_link\n"
    path.write_text(f"{frames}vector_noise_nT: 1.0\nscalar_noise_nT: 0.1\n")
    publish_transforms(bench, transforms_of(array, array.mounting))
    children = bench.start_nodes(collector={"array_file": path}, calibrator={"array_file": path})
    expected = recording.take(slice(0, 60))
    samples = bench.listen(sensor_msgs.PointCloud2, "samples")
    publish = bench.publish_sensors()
    bench.connect(collector={"samples": 2})
    bench.play(array.mounting.inverse.turned(expected), publish, samples)
    bench.stored(60)
    answer = bench.call("calibrator/calibrate")
    assert answer.success, answer.message
    calibrations = bench.listen(std_msgs.String, "calibration", latched=True)
    bench.spin_until(lambda: calibrations, "the calibration is published")
    live = calibration_from_yaml(calibrations[0].data, "the topic")
    assert live.is_of(array) and not live.is_of(replace(array, mounting=Mounting()))
    assert_allclose(live.array.mounting.imu_rotation, array.mounting.imu_rotation, atol=1e-12)
    assert_allclose(live.errors.matrix, calibrate(expected, array).errors.matrix, atol=1e-9)
    assert "/tf_static states where the sensors are: sensor 1 at 0.25 0 0 m" in children.log("collector")


def test_what_tf_does_not_tell_is_said(bench, tmp_path, monkeypatch):
    """A node that knows no positions ends with a sentence: without tf2_msgs at once, else after some seconds."""
    from tam_calibration.nodes import node_parameters

    path = tmp_path / "frames.yaml"
    path.write_text("frame_ids: [tam_1_link]\n")
    code, said = end_of_start(path)
    assert code == 2 and said.startswith(f"tam: {path}: it leaves positions to tf, and tf2_msgs is not installed")
    put_in_place_of_tf2_msgs(tmp_path, monkeypatch)
    assert node_parameters.PATIENCE_S == 10.0  # as docs/how_to/robot.md says
    monkeypatch.setattr(node_parameters, "PATIENCE_S", 0.1)
    transforms = node_parameters.StaticTransforms(bench.node, "tam_array")
    with pytest.raises(InputError, match="/tf_static leads from tam_array to no tam_1_link: publish that transform"):
        transforms.look_up("tam_1_link")
    bench.node.destroy_subscription(transforms.subscription)


def end_of_start(array_file):
    """Return exit code and what it says of a collector that ends at its start."""
    command = [sys.executable, *START, "collector", "--ros-args", "-p", f"array_file:={array_file}"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    return done.returncode, done.stderr
