"""Frames that are looked up in what a bag holds of tf: by commands whose array file leaves positions to it."""

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from tam_calibration.cli.main import main
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.recordings import read_array
from tam_calibration.recordings.array_yaml import transforms_in
from tam_calibration.results import read_calibration

STORE = get_typestore(Stores.ROS2_JAZZY)
FIELD, TRANSFORMS = "sensor_msgs/msg/MagneticField", "tf2_msgs/msg/TFMessage"


def make(name, *values):
    """Make a message of rosbags."""
    return STORE.types[name](*values)


def header(stamp_ns, frame_id):
    """Make a header."""
    return make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9)), frame_id)


def write_bag(path, recording, array):
    """Write what four turned drivers and a robot_state_publisher would publish, a message of tf for each sensor."""
    drivers = array.mounting.inverse.turned(recording)
    with Writer(path, version=9) as writer:
        topics = [f"/tam_{sensor}/magnetic_field" for sensor in (1, 2, 3, 4)] + ["/scalar/intensity"]
        fields = [writer.add_connection(topic, FIELD, typestore=STORE) for topic in topics]
        static = writer.add_connection("/tf_static", TRANSFORMS, typestore=STORE)
        for sensor, (place, turn) in enumerate(zip(array.positions_m, array.mounting.rotations, strict=True), 1):
            transform = make(
                "geometry_msgs/msg/Transform",
                make("geometry_msgs/msg/Vector3", *place),
                make("geometry_msgs/msg/Quaternion", *turn),
            )
            stamped = make(
                "geometry_msgs/msg/TransformStamped", header(0, "tam_array"), f"tam_{sensor}_link", transform
            )
            message = make(TRANSFORMS, [stamped])
            writer.write(static, 1, STORE.serialize_cdr(message, TRANSFORMS))
        for time_s, readings, scalar in zip(recording.time_s, drivers.readings_T, recording.scalar_T, strict=True):
            stamp_ns = round(time_s * 1e9)
            for connection, vector in zip(fields, [*readings, [scalar, 0.0, 0.0]], strict=True):
                field = make(FIELD, header(stamp_ns, "any"), make("geometry_msgs/msg/Vector3", *vector), np.zeros(9))
                writer.write(connection, stamp_ns, STORE.serialize_cdr(field, FIELD))


def test_a_bag_with_tf_is_calibrated_and_corrected(tmp_path, monkeypatch, recording):
    """With an array file of frames alone, as if positions and rotations had been stated."""
    monkeypatch.chdir(tmp_path)
    rotations = Rotation.from_euler("xyz", [[0, 0, 0], [0, 0, 90], [180, 0, 30], [10, -20, 130]], degrees=True)
    array = Array(Array.cross(0.5).positions_m, np.full(4, 1e-9), 1e-10, mounting=Mounting(rotations.as_quat()))
    part = recording.take(slice(0, 150))
    write_bag(tmp_path / "run", part, array)
    frames = "frame_ids: [tam_1_link, tam_2_link, tam_3_link, tam_4_link]"
    Path("frames.yaml").write_text(f"{frames}\nvector_noise_nT: 1.0\nscalar_noise_nT: 0.1\n")
    for words in (
        ["calibrate", "run", "--array", "frames.yaml", "-o", "calibration.yaml"],
        ["correct", "run", "--calibration", "calibration.yaml", "--array", "frames.yaml", "-o", "corrected.csv"],
    ):
        result = CliRunner().invoke(main, words)
        assert result.exit_code == 0, result.output
    found, expected = read_calibration(Path("calibration.yaml")), calibrate(part, array)
    assert found.is_of(array)
    assert_allclose(found.errors.matrix, expected.errors.matrix, atol=1e-9)
    columns = np.loadtxt("corrected.csv", delimiter=",", skiprows=1)[:, 1:10]
    assert_allclose(1e-9 * columns, expected.correct(part).outputs, atol=1e-13)


def test_what_a_recording_does_not_tell_of_tf_is_said(tmp_path, recording):
    """A CSV file tells no frame."""
    path = tmp_path / "array.yaml"
    path.write_text("frame_ids: [tam_1_link]\n")
    run = tmp_path / "run.csv"
    run.write_text("time_s,b1x_nT,b1y_nT,b1z_nT\n0,1,2,3\n")
    with pytest.raises(InputError, match=r"run\.csv has no /tf_static that leads from tam_array to tam_1_link"):
        read_array(path, transforms_in(run))
