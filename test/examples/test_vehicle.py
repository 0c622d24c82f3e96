"""The vehicle that MuJoCo moves."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from vehicle import VehicleRun, model_xml, sense, simulate_vehicle

from tam_calibration.fit import calibrate
from tam_calibration.fit.coverage import cell_directions
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: .venv/bin/pip install -e '.[compare]'")

RUN = VehicleRun(seed=1, sample_count=2000)


@pytest.fixture(scope="module")
def made():
    """Return the recording and the array of a run."""
    return simulate_vehicle(RUN)


def turns(recording):
    """Return the rotations from the vehicle to the world."""
    return Rotation.from_quat(recording.attitude)


def test_mujoco_turns_the_field_of_the_world_into_the_vehicle(made):
    """Its magnetometers, of every site alike, read what its attitude says, to rounding."""
    sensed = sense(RUN)
    expected = turns(made[0]).inv().apply(RUN.field_T)
    for name in ("tam_1", "tam_2", "tam_3", "tam_4", "scalar"):
        assert_allclose(sensed[name], expected, rtol=0, atol=1e-12 * norm(RUN.field_T))


def test_readings_hold_the_errors_and_the_noise_that_were_asked_for():
    """Of each sensor its own, and of the scalar."""
    noise_T = np.array([1e-9, 2e-9, 3e-9, 4e-9])
    errors = replace(
        SensorErrors.none(4), bias_T=np.arange(12.0).reshape(4, 3) * 1e-7, scale_factor=np.full((4, 3), 1.01)
    )
    run = replace(RUN, errors=errors, vector_noise_T=noise_T, scalar_noise_T=5e-10)
    recording, array = simulate_vehicle(run)
    left = recording.readings_T - errors.distort(turns(recording).inv().apply(run.field_T))
    assert_allclose(left.std(axis=0), np.repeat(noise_T[:, None], 3, axis=1), rtol=0.06)  # 4 standard errors
    assert_allclose((recording.scalar_T - norm(run.field_T)).std(), 5e-10, rtol=0.06)
    assert_array_equal(array.vector_noise_T, noise_T)
    assert array.scalar_noise_T == 5e-10


def test_the_vehicle_turns_through_all_directions_and_stays_where_it_is(made):
    """Four cells of five see the field within 100 s, at 0.3 to 1.5 rad/s nearly always; it drifts by some metres."""
    rotation = turns(made[0])
    seen = rotation.inv().apply(RUN.field_T / norm(RUN.field_T)) @ cell_directions().T
    assert len(set(seen.argmax(axis=1))) >= 160
    rate = (rotation[:-1].inv() * rotation[1:]).magnitude() * RUN.rate_hz
    assert 0.25 < np.percentile(rate, 2) < 0.45 and 1.3 < np.percentile(rate, 98) < 1.6
    assert 0.1 < norm(sense(RUN)["place"], axis=1).max() < 5


def test_the_thrusters_keep_to_the_peak_of_the_run():
    """Half the peak turns the vehicle half as fast."""
    rotation = turns(simulate_vehicle(replace(RUN, peak_turn_rate=0.75))[0])
    rate = (rotation[:-1].inv() * rotation[1:]).magnitude() * RUN.rate_hz
    assert 0.5 < rate.max() < 0.85


def test_a_seed_gives_a_path_and_its_noise(made):
    """The same run gives the same recording, another seed another path, another noise seed the same path."""
    recording = made[0]
    again, other, noisy = (
        simulate_vehicle(replace(RUN, **change))[0] for change in ({}, {"seed": 2}, {"noise_seed": 2})
    )
    assert_array_equal(again.readings_T, recording.readings_T)
    assert (other.attitude != recording.attitude).any(axis=1).all()
    assert_array_equal(noisy.attitude, recording.attitude)
    assert (noisy.readings_T != recording.readings_T).all()
    assert np.abs(noisy.readings_T - recording.readings_T).max() < 8e-9


def test_a_seed_stands_for_the_same_path_in_every_version(made):
    """Figures that name a seed can be made again: where seed 1 has turned the vehicle after 10 s."""
    assert_allclose(made[0].attitude[199], [-0.5423, 0.0057, -0.5924, -0.5958], rtol=0, atol=1e-3)


def test_what_else_is_recorded_changes_no_noise():
    """An IMU has one sensor and its attitude, with the noise that it has beside a scalar magnetometer."""
    one = replace(RUN, positions_m=np.zeros((1, 3)))
    imu = replace(one, scalar_noise_T=None, temperature=None, current=None)
    (alone, _), (beside, _) = simulate_vehicle(imu), simulate_vehicle(one)
    assert alone.scalar_T is alone.temperature_C is alone.current_A is None
    assert_array_equal(alone.readings_T, beside.readings_T)
    assert beside.temperature_C[[0, -1]].tolist() == [20, 25]
    assert set(beside.current_A) == {0.5, 3.0}


@pytest.mark.parametrize(("rate_hz", "steps"), [(1.0, 100), (20.0, 5), (142.857, 1), (500.0, 1)])
def test_samples_are_as_far_apart_as_the_physics_went(rate_hz, steps):
    """At every rate the steps of the physics, of at most 10 ms, add up to the time between samples."""
    run = replace(RUN, rate_hz=rate_hz)
    step_s = mujoco.MjModel.from_xml_string(model_xml(run)).opt.timestep
    assert run.steps_per_sample == steps
    assert_allclose(step_s * run.steps_per_sample, np.diff(run.time_s)[0], rtol=1e-12)


def test_a_calibration_of_it_leaves_noise_alone(made):
    """The errors of perfect sensors come out within their standard errors, and the reduced χ² is 1."""
    calibration = calibrate(*made)
    assert all(abs(value - 1) < 0.1 for value in calibration.reduced_chi_square.values())
    assert np.abs(calibration.errors.bias_T).max() < 5 * 0.04e-9


def test_without_mujoco_one_sentence_says_what_to_install(monkeypatch):
    """Where it is not installed."""
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InputError, match=r"the vehicle needs mujoco: pip install 'tam_calibration\[compare\]'"):
        sense(RUN)
