"""Plans keep their promise, beat chance, and refuse what cannot be reached."""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.fit.information import information_of
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.plan import (
    field_directions,
    make_plan,
    reach_of_turntable,
    reach_of_vehicle,
    start_from_calibration,
    start_from_nothing,
    start_from_recording,
)
from tam_calibration.fit.published import lossless
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

INTENSITY_T, INCLINATION = 54955.83e-9, from_degrees(62.3)
NORTH_WEST_UP = INTENSITY_T * np.array([np.cos(INCLINATION), 0, -np.sin(INCLINATION)])
POSES, SAMPLES = 12, 50


def from_degrees_of(*angles):
    """Return angles in radians."""
    return from_degrees(np.array(angles, dtype=float))


@dataclass(frozen=True)
class Rests:
    """Attitudes yaw, pitch, roll (N, 3) one after the other."""

    angles: np.ndarray

    def attitudes(self, time_s, generator):
        """Return their quaternions."""
        return Rotation.from_euler("ZYX", self.angles).as_quat()


def scenario_of(wu_scenario, angles, seed=1):
    """Return Wu's array at rest in attitudes, the world's x to magnetic north."""
    motion, count = Rests(angles), len(angles)
    return replace(wu_scenario, motion=motion, site_field_T=NORTH_WEST_UP, sample_count=count, seed=seed)


@pytest.fixture(scope="module")
def narrow_angles():
    """Return full circles of yaw with little pitch and roll."""
    time_s = np.arange(300.0)
    quaternions = Manoeuvre(*from_degrees_of(10, 10), 60.0).attitudes(time_s, np.random.default_rng(0))
    return Rotation.from_quat(quaternions).as_euler("ZYX")


@pytest.fixture(scope="module")
def narrow(wu_scenario, narrow_angles):
    """Return the recording of them."""
    return simulate(scenario_of(wu_scenario, narrow_angles)).recording


@pytest.fixture(scope="module")
def reach():
    """Return what a vehicle with 30° of pitch and roll can reach."""
    return reach_of_vehicle(*from_degrees_of(30, 30), INCLINATION)


@pytest.fixture(scope="module")
def start(narrow, wu_scenario):
    """Return what the narrow recording determines."""
    return start_from_recording(narrow, wu_scenario.array)


@pytest.fixture(scope="module")
def nothing(wu_scenario):
    """Return the start from nothing."""
    return start_from_nothing(wu_scenario.array, INTENSITY_T)


@pytest.fixture(scope="module")
def plan(start, reach):
    """Return the plan of what to add."""
    return make_plan(start, start.model.intensity_T * reach.directions, POSES, SAMPLES)


def worst_of(start, directions, poses):
    """Return the worst standard error, in units of the noise, after poses given by their numbers."""
    rows = start.model.rows(start.model.intensity_T * directions[poses])
    variances = start.model.variances(start.information + information_of(rows) * SAMPLES)
    return np.sqrt(np.max(variances * start.model.noise_units**2))


def test_the_plan_keeps_its_promise(wu_scenario, narrow_angles, reach, plan):
    """The fit to the narrow recording with the planned poses added has the standard errors that it promised."""
    angles = np.concatenate([narrow_angles, np.repeat(reach.angles[plan.poses], SAMPLES, axis=0)])
    found = maximum_likelihood(simulate(scenario_of(wu_scenario, angles)).recording, wu_scenario.array)
    assert (plan.standard_errors > 0).sum() == 45
    assert_allclose(found.standard_errors, plan.standard_errors, rtol=0.02)


def test_a_planned_calibration_is_accepted(wu_scenario, nothing):
    """Twelve planned poses alone are enough for a calibration, and its standard errors are those of the plan."""
    reach = reach_of_turntable(from_degrees_of(30, 30, 30), INCLINATION)
    plan = make_plan(nothing, INTENSITY_T * reach.directions, POSES, SAMPLES)
    angles = np.repeat(reach.angles[plan.poses], SAMPLES, axis=0)
    calibration = calibrate(simulate(scenario_of(wu_scenario, angles)).recording, wu_scenario.array)
    free = plan.standard_errors > 0
    assert_allclose(calibration.standard_errors[free], plan.standard_errors[free], rtol=0.1)


def test_the_plan_beats_chance(start, nothing, reach, plan):
    """No random choice among a hundred does as well, and the usual one is more than twice as bad."""
    generator = np.random.default_rng(3)
    draws = generator.integers(0, len(reach.angles), (100, POSES))
    whole = make_plan(nothing, INTENSITY_T * reach.directions, POSES, SAMPLES)
    for origin, planned in ((start, plan), (nothing, whole)):
        chance = [worst_of(origin, reach.directions, draw) for draw in draws]
        assert planned.worst[-1] == pytest.approx(worst_of(origin, reach.directions, planned.poses))
        assert planned.worst[-1] < np.min(chance)
        assert planned.worst[-1] < np.median(chance) / 2


def test_a_vehicle_that_stays_level_cannot_determine_everything(nothing):
    """Without pitch and roll the plan is refused, and names what stays open."""
    level = reach_of_vehicle(0.0, 0.0, INCLINATION)
    with pytest.raises(Refused, match=r"best 12 poses .* scale factor z.*bias z of every sensor.*allow more pitch"):
        make_plan(nothing, INTENSITY_T * level.directions, POSES, SAMPLES)


def test_too_few_poses_are_refused(nothing, reach):
    """Eight directions do not determine the nine parameters of an ellipsoid, nine do."""
    with pytest.raises(Refused, match="plan more poses"):
        make_plan(nothing, INTENSITY_T * reach.directions, 8, SAMPLES)
    assert np.isinf(make_plan(nothing, INTENSITY_T * reach.directions, 9, SAMPLES).worst).sum() == 8


def test_a_level_circle_is_made_use_of(wu_scenario, reach, nothing):
    """What a recording that leaves parameters open does tell saves poses."""
    circle = np.zeros((200, 3))
    circle[:, 0] = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    recording = simulate(scenario_of(wu_scenario, circle)).recording
    start = start_from_recording(recording, wu_scenario.array)
    assert start.standard_errors is None and np.isinf(start.worst)
    assert "bias z" in start.note or "scale factor z" in start.note
    plan = make_plan(start, start.model.intensity_T * reach.directions, 6, SAMPLES)
    assert plan.worst[-1] < 2 * make_plan(nothing, INTENSITY_T * reach.directions, 12, SAMPLES).worst[-1]


def test_raw_readings_without_scalar_tell_the_intensity(wu_scenario):
    """By their lengths, where a calibration is not to be had."""
    circle = np.zeros((200, 3))
    circle[:, 0] = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    recording = replace(simulate(scenario_of(wu_scenario, circle)).recording, scalar_T=None)
    start = start_from_recording(recording, wu_scenario.array)
    assert start.standard_errors is None
    assert start.model.intensity_T == pytest.approx(INTENSITY_T, rel=0.03)


def test_no_other_pose_is_better_instead_of_one(nothing):
    """By a thousandth of the largest standard error, each in units of what noise makes of it, which the plan tells."""
    wide = reach_of_vehicle(from_degrees(60), from_degrees(60), INCLINATION)
    model, candidates = nothing.model, INTENSITY_T * wide.directions[::20]
    plan, rows = make_plan(nothing, candidates, POSES, SAMPLES), model.rows(candidates)

    def worst(chosen):
        information = information_of(rows[np.array(chosen)]) * SAMPLES
        return np.max(np.sqrt(model.variances(information)) * model.noise_units)

    chosen = plan.poses.tolist()
    assert worst(chosen) == pytest.approx(plan.worst[-1], rel=1e-6)
    for place, other in product(range(POSES), range(len(candidates))):
        assert worst([*chosen[:place], other, *chosen[place + 1 :]]) > 0.999 * plan.worst[-1]


def test_a_calibration_tells_as_much_as_its_recording(narrow, wu_scenario, start):
    """The covariance of a calibration gives back the information of its recording."""
    calibration = maximum_likelihood(narrow, wu_scenario.array)
    again = start_from_calibration(calibration)
    assert_allclose(again.standard_errors, calibration.standard_errors, rtol=1e-6)
    assert_allclose(again.information[:9, :9], start.information[:9, :9], rtol=1e-6)


def test_a_calibration_without_information_is_refused(wu_run, wu_scenario):
    """Neither a covariance that is no inverse of an information, nor an unknown scale can be added to."""
    array = wu_scenario.array
    with pytest.raises(InputError, match="by lossless is not the inverse of an information"):
        start_from_calibration(lossless(wu_run.recording, array))
    with pytest.raises(InputError, match="no scalar reference"):
        start_from_calibration(maximum_likelihood(replace(wu_run.recording, scalar_T=None), array))


def test_recordings_without_scalar_are_planned_for(narrow, wu_scenario, reach):
    """With an unknown constant intensity the standard errors before are those of the fit, and fall."""
    recording = replace(narrow, scalar_T=None)
    start = start_from_recording(recording, wu_scenario.array)
    expected = maximum_likelihood(recording, wu_scenario.array).standard_errors
    assert_allclose(start.standard_errors[1:], expected[1:], rtol=1e-3)
    plan = make_plan(start, start.model.intensity_T * reach.directions, 6, SAMPLES)
    assert plan.worst[-1] < start.worst / 5


def test_one_sensor_is_planned_for(reach):
    """A single sensor has nine parameters and no misalignment."""
    start = start_from_nothing(Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10), INTENSITY_T)
    plan = make_plan(start, INTENSITY_T * reach.directions, POSES, SAMPLES)
    assert (plan.standard_errors[0] > 0).tolist() == [True] * 9 + [False] * 3


def test_recorded_attitude_tells_the_inclination(wu_scenario, narrow_angles):
    """The field's inclination is found in the world of the attitude."""
    scenario = replace(scenario_of(wu_scenario, narrow_angles), attitude=AttitudeChannel(0.0))
    start = start_from_recording(simulate(scenario).recording, wu_scenario.array)
    assert start.inclination == pytest.approx(INCLINATION, abs=1e-3)


def test_unknown_noise_cannot_be_planned_with():
    """A plan from nothing needs the noise of the sensors."""
    with pytest.raises(InputError, match="vector_noise_nT"):
        start_from_nothing(Array.cross(0.5), INTENSITY_T)


def test_senses_of_rotation():
    """Yaw turns to the left, pitch lowers the nose, roll lowers the right side."""
    angles = np.array([[np.pi / 2, 0, 0], [0, np.pi / 2, 0], [0, 0, np.pi / 2]])
    north = field_directions(angles, 0.0)
    down = field_directions(angles, np.pi / 2)
    assert_allclose(north[0], [0, -1, 0], atol=1e-12)
    assert_allclose(down[1], [1, 0, 0], atol=1e-12)
    assert_allclose(down[2], [0, -1, 0], atol=1e-12)


def test_reach_stays_within_limits_and_reaches_them(reach):
    """A vehicle's attitudes span their limits and yaw right round; no direction comes twice."""
    assert_allclose(np.abs(reach.angles[:, 1:]).max(axis=0), from_degrees_of(30, 30))
    assert np.ptp(reach.angles[:, 0]) > from_degrees(340)
    assert len(np.unique(np.round(reach.directions, 4), axis=0)) == len(reach.directions)
    assert_allclose(np.linalg.norm(reach.directions, axis=1), 1)


def test_turntable_steps_are_kept():
    """Every angle is a multiple of the axis' step, and an axis with step 0 rests."""
    steps = from_degrees_of(30, 45, 0)
    angles = reach_of_turntable(steps, INCLINATION).angles
    assert_allclose(angles[:, :2] / steps[:2], np.round(angles[:, :2] / steps[:2]), atol=1e-9)
    assert (angles[:, 2] == 0).all()


@pytest.mark.parametrize("limits_deg", [(-1, 0), (91, 0), (0, 181), (float("nan"), 0)])
def test_impossible_limits(limits_deg):
    """Limits that no vehicle has are bad input."""
    with pytest.raises(InputError, match="pitch limit must lie between 0 and 90"):
        reach_of_vehicle(*from_degrees_of(*limits_deg), INCLINATION)


@pytest.mark.parametrize("step_deg", [-10, 181, float("nan"), float("inf"), 1e-6, 1e-300, -1e-9])
def test_impossible_steps(step_deg):
    """Steps of more than half a turn, less than none, or finer than any turntable are bad input."""
    with pytest.raises(InputError, match="steps of a turntable"):
        reach_of_turntable(from_degrees_of(step_deg, 30, 30), INCLINATION)
