"""An attitude that was written otherwise is named; right ones, and what cannot be told, are not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.model.units import from_degrees
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

NED_OF_ENU = Rotation.from_matrix([[0, 1, 0], [1, 0, 0], [0, 0, -1]])
FRD_OF_FLU = Rotation.from_quat([1, 0, 0, 0])


def inverse(attitude):
    """Return quaternions of the inverse."""
    return attitude * [-1, -1, -1, 1]


def as_ned(attitude):
    """Return attitudes of an autopilot: from forward, right, down to north, east, down."""
    return (NED_OF_ENU * Rotation.from_quat(attitude) * FRD_OF_FLU.inv()).as_quat()


WRITTEN = {
    "turns the world into the array: write": lambda attitude: inverse(attitude),
    "has its quaternions in the order w, x, y, z": lambda attitude: attitude[:, [3, 0, 1, 2]],
    "turns the world into the array, and is in the order w": lambda attitude: inverse(attitude)[:, [3, 0, 1, 2]],
    "is that of axes forward, right, down (NED), or axis x of all sensors is reversed: state imu_rotation_deg": as_ned,
    "forward, right, down (NED), and turns the world": lambda attitude: inverse(as_ned(attitude)),
    "hardly changes while the readings turn": lambda attitude: attitude[:1].repeat(len(attitude), axis=0),
}


@pytest.fixture(scope="module")
def made():
    """Return a turning array with attitude."""
    scenario = read_scenario("tumble_100_hz")
    return simulate(replace(scenario, sample_count=2000, attitude=AttitudeChannel(from_degrees(1.0))))


@pytest.mark.parametrize("words", WRITTEN)
@pytest.mark.parametrize("is_calibrated", [False, True])
def test_another_way_of_writing_is_named(made, words, is_calibrated):
    """By raw readings and by corrected ones, with what to do."""
    recording = replace(made.recording, attitude=WRITTEN[words](made.recording.attitude))
    told = misread_attitude(recording, made.scenario.errors if is_calibrated else None)
    assert told.startswith("the recorded attitude ") and words in told and ": " in told


def test_right_attitudes_are_not_named(made):
    """Whatever the world is turned by, with 5° of noise, and where there is none."""
    assert misread_attitude(made.recording) == ""
    turned = (Rotation.from_euler("z", 130, degrees=True) * Rotation.from_quat(made.recording.attitude)).as_quat()
    assert misread_attitude(replace(made.recording, attitude=turned)) == ""
    noise = Rotation.from_rotvec(from_degrees(5.0) * np.random.default_rng(1).normal(size=(2000, 3)))
    noisy = (Rotation.from_quat(made.recording.attitude) * noise).as_quat()
    assert misread_attitude(replace(made.recording, attitude=noisy)) == ""
    assert misread_attitude(replace(made.recording, attitude=None)) == ""


@pytest.mark.parametrize("limit_deg", [0.5, 3.0, 20.0])
def test_a_vehicle_that_hardly_pitches_is_right(limit_deg):
    """Level turns with little pitch and roll."""
    limit = from_degrees(limit_deg)
    scenario = replace(read_scenario("wu_table_1"), motion=Manoeuvre(limit, limit, 60.0), sample_count=300, rate_hz=5.0)
    made = simulate(replace(scenario, attitude=AttitudeChannel(from_degrees(1.0))))
    assert misread_attitude(made.recording) == misread_attitude(made.recording, made.scenario.errors) == ""


@pytest.mark.parametrize("axis", "xyz")
def test_left_handed_sensors_are_told(made, axis):
    """All alike, so that no sensor contradicts another."""
    signs = np.where(np.array(list("xyz")) == axis, -1.0, 1.0)
    told = misread_attitude(replace(made.recording, readings_T=made.recording.readings_T * signs))
    assert f"axis {axis} of all sensors is reversed" in told
