"""Rotations of sensors and IMU: their convention, the same bits for numbers and arrays, and what is none."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting, quaternion_of
from tam_calibration.model.recording import Recording

TURNED = Mounting(
    Rotation.from_euler("xyz", [[0, 0, 0], [10, -20, 130], [180, 0, 0]], degrees=True).as_quat(),
    Rotation.from_euler("xyz", [5, 90, -30], degrees=True).as_quat(),
)


@pytest.fixture
def recording():
    """Return a recording of three sensors with an attitude, of which one is missing."""
    rng = np.random.default_rng(3)
    attitude = Rotation.random(50, rng=rng).as_quat()
    attitude[7] = np.nan
    return Recording(np.arange(50) / 10, 5e-5 * rng.normal(size=(50, 3, 3)), attitude=attitude)


@pytest.mark.parametrize(
    ("roll_pitch_yaw_deg", "axes"),
    [
        ((0, 0, 90), [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]),
        ((90, 0, 0), [[1, 0, 0], [0, 0, 1], [0, -1, 0]]),
        ((0, 90, 0), [[0, 0, -1], [0, 1, 0], [1, 0, 0]]),
        ((90, 0, 90), [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
    ],
)
def test_roll_pitch_and_yaw_are_about_fixed_axes(roll_pitch_yaw_deg, axes):
    """Where the sensor's axes x, y, z point in the array, as in URDF: roll first, yaw last, about the array's axes."""
    turn = Mounting(quaternion_of(np.radians([roll_pitch_yaw_deg]))).sensor_turns[0]
    assert_allclose([turn(*axis) for axis in np.eye(3)], axes, atol=1e-15)


def test_a_recording_comes_into_the_axes_of_the_array(recording):
    """Readings are turned by the sensor's rotation; a vector is the same in the world by IMU and array."""
    turned = TURNED.turned(recording)
    for sensor, rotation in enumerate(Rotation.from_quat(TURNED.rotations)):
        assert_allclose(turned.readings_T[:, sensor], rotation.apply(recording.readings_T[:, sensor]), atol=1e-19)
    assert_array_equal(turned.readings_T[:, 0], recording.readings_T[:, 0])
    known = np.isfinite(recording.attitude[:, 0])
    in_imu = np.array([0.3, -2.0, 1.0])
    in_array = Rotation.from_quat(TURNED.imu_rotation).apply(in_imu)
    by_imu, by_array = (Rotation.from_quat(each.attitude[known]) for each in (recording, turned))
    assert_allclose(by_array.apply(in_array), by_imu.apply(in_imu), atol=1e-14)
    assert np.isnan(turned.attitude[~known]).all()


def test_single_readings_have_the_bits_of_many(recording):
    """What is turned live, one by one, is what is turned offline."""
    turned = TURNED.turned(recording)
    one_by_one = [TURNED.sensor_turns[1](*reading.tolist()) for reading in recording.readings_T[:, 1]]
    assert_array_equal(one_by_one, turned.readings_T[:, 1])
    assert_array_equal([TURNED.attitude_turn(*each.tolist()) for each in recording.attitude], turned.attitude)


def test_the_inverse_turns_back(recording):
    """To the readings and the attitude of the drivers."""
    again = TURNED.inverse.turned(TURNED.turned(recording))
    assert_allclose(again.readings_T, recording.readings_T, atol=1e-19)
    assert_allclose(again.attitude, recording.attitude, atol=1e-15)


def test_without_rotation_nothing_is_touched(recording):
    """The recording is the same object, also for sensors of which every rotation is none."""
    assert Mounting().turned(recording) is recording
    assert Mounting(np.tile([0, 0, 0, 1.0], (3, 1))).turned(recording) is recording


@pytest.mark.parametrize(
    ("stated", "sentence"),
    [
        ({"rotations": [[0, 0, 0, 1], [0, 0, 0, 0]]}, "the rotation of sensor 2 is no rotation"),
        ({"rotations": [[0, 0, np.nan, 1]]}, "the rotation of sensor 1 is no rotation"),
        ({"rotations": [[0, 0, 0, 1.011]]}, "of length 1"),
        ({"rotations": [[0, 0, 1]]}, "x, y, z, w"),
        ({"rotations": [0, 0, 0, 1]}, "a row for each sensor"),
        ({"imu_rotation": [0, 0, 0, 0]}, "the rotation of the IMU is no rotation"),
    ],
)
def test_what_is_no_rotation_is_refused(stated, sentence):
    """With the sensor and what was given."""
    with pytest.raises(InputError, match=sentence):
        Mounting(**stated)


def test_rounded_quaternions_are_made_of_length_1():
    """Three digits are enough to write one."""
    assert_allclose(np.linalg.norm(Mounting([[0, 0, 0.707, 0.707]]).rotations), 1, rtol=1e-15)
    assert Mounting([[0, 0, 0, 1.0099]]).rotations.tolist() == [[0, 0, 0, 1]]


@pytest.mark.parametrize("stated", [{"rotations": [[0, 0, 0, 1]]}, {"frame_ids": ("a", "b", "c")}])
def test_each_sensor_has_its_own(stated):
    """Another number of them than of sensors is refused."""
    with pytest.raises(InputError, match="needs one for each of 4 sensors"):
        Array(Array.cross(0.5).positions_m, mounting=Mounting(**stated))


def test_an_array_is_another_when_its_sensors_are_turned():
    """By more than rounding; a quaternion and its negative are one rotation, and none is none."""
    cross, rotations = Array.cross(0.5), np.tile([0, 0, 0, 1.0], (4, 1))
    turned = rotations.copy()
    turned[2] = [0, 0, 0.6, 0.8]

    def of(rotations):
        return Array(cross.positions_m, mounting=Mounting(rotations))

    assert of(rotations).has_geometry_of(cross) and cross.has_geometry_of(of(-rotations))
    assert of(turned).has_geometry_of(of(-turned + 1e-8)) and not of(turned).has_geometry_of(cross)
    assert not of(turned).has_geometry_of(of(turned + np.array([0, 0, 2e-6, -1.5e-6])))
