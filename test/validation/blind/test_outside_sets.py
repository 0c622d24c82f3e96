"""The second, the fifth and the sixth set of causes outside the library."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.units import to_nanotesla
from tam_validation.blind import SETS
from tam_validation.blind.case_plan import plan_cases
from tam_validation.blind.catalogue import CATALOGUE, CAUSES, LAWS, OUTSIDE_SETS
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.outside_fifth import FIFTH
from tam_validation.blind.outside_second import SECOND
from tam_validation.blind.outside_sixth import SIXTH

COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}
KINDS_OF_LAW = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}


def test_the_sets_share_no_name():
    """Neither with each other nor with the library."""
    names = [name for one in (CATALOGUE, *OUTSIDE_SETS.values()) for name in one]
    assert tuple(OUTSIDE_SETS) == SETS and len(names) == len(set(names)) == len(CAUSES)


@pytest.mark.parametrize("name", [*SECOND, *FIFTH, *SIXTH])
def test_every_cause_has_a_law_and_a_course(name):
    """Of those that there are."""
    right = LAWS[name]
    assert right["law"] and right["course"]
    assert set(right["law"]) <= KINDS_OF_LAW and set(right["course"]) <= COURSES


@pytest.mark.parametrize("causes", [SECOND, FIFTH, SIXTH])
def test_every_law_is_in_a_set(causes):
    """Each is the usual one of some cause, and most courses are."""
    assert {LAWS[name]["law"][0] for name in causes} == KINDS_OF_LAW
    assert len({LAWS[name]["course"][0] for name in causes}) >= 7


@pytest.mark.parametrize("name", SETS)
def test_a_plan_draws_from_one_set(name):
    """All causes of the set, and of no other; mixtures take those that leave a sensor to another cause."""
    single = {plan.effects[0] for plan in plan_cases(("outside",), 60, 3, name)}
    mixed = plan_cases(("mixed",), 120, 3, name)
    assert single == set(OUTSIDE_SETS[name]) and len(mixed) == 120
    beside = {plan.effects[1] for plan in mixed}
    everywhere = {"proton_polarisation", "moist_boards", "walking_operator", "arc_welder"}
    assert beside == single - everywhere - {"left_toolbox", "folding_arms", "viscous_hull"}


def test_a_knife_is_near_for_a_small_part_of_the_time(change_of):
    """Its field falls with the third power of the distance."""
    _, _, change = change_of("dive_knife", 2)
    size = np.linalg.norm(change, axis=1)
    assert np.median(size) < 0.3 * size.max()


def test_swapped_packets_are_the_same_readings_in_another_order(draw):
    """No reading is lost, and none stands twice."""
    scene = draw(1)
    cause = SECOND["swapped_packets"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(0.1, (scene.readings_T, scene.intensity_T))
    sensor = cause.sensors[0] - 1
    before, after = scene.readings_T[:, sensor, 0], (scene.readings_T + vectors)[:, sensor, 0]
    assert np.ptp(vectors) > 0
    np.testing.assert_allclose(np.sort(before), np.sort(after), rtol=1e-12)


def test_who_walks_around_yaws_along(draw):
    """While the array is not tilted, the iron in the pockets stays at one place beside it."""
    scene = draw(1)

    def angles(time_s):
        return np.outer(time_s, [0.3, 0, 0]) + np.outer(time_s > scene.duration_s / 2, [0, 0.5, 0])

    turning = replace(scene, motion=ContinuousMotion("tumbling", angles))
    vectors, _ = FIFTH["walking_operator"].draw(np.random.default_rng(1), turning).change(1.0, ())
    level = scene.time_s < scene.duration_s / 2
    assert np.ptp(vectors[level], axis=0).max() < 1e-6 * np.ptp(vectors, axis=0).max()


def test_a_ramp_meets_large_values_late(draw):
    """The error is the change of the reading in a time that grows with the reading itself."""
    scene = draw(2)
    cause = SIXTH["ramp_converter"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-4, ())
    sensor = cause.sensors[0] - 1
    rate = (scene.readings_at(scene.time_s + 1e-4) - scene.readings_T)[:, sensor] / 1e-4
    late = vectors[:, sensor] / rate / scene.core(sensor)
    moving = np.abs(rate) > 1e-6
    np.testing.assert_allclose(np.abs(late[moving & (vectors[:, sensor] != 0)]), 1e-4, rtol=0.05)


def test_a_wrong_entry_spoils_the_readings_about_it(change_of):
    """The error is largest at one reading, and none at those that are farther away."""
    scene, cause, change = change_of("wrong_table_entry", 2)
    axis = "xyz".index(cause.axes[0])
    error, reading = np.abs(change[:, axis]), scene.readings_T[:, cause.sensors[0] - 1, axis]
    near = np.abs(reading - reading[error.argmax()]) < np.ptp(reading) / 4
    assert 0 < (error > 0).mean() < 0.6 and not error[~near].any()


def test_a_gripper_is_beside_the_sensor_now_and_then(change_of):
    """It makes a dipole's field, twice as large along the dipole as across, and hardly any from its place."""
    _, _, change = change_of("soft_gripper", 3)
    size = to_nanotesla(np.linalg.norm(change, axis=1))
    assert 0.05 < (size > 0.9).mean() < 0.7 and size.max() < 2.3 and size.min() < 0.05


def test_a_mean_with_lost_readings_is_too_small(change_of):
    """By so many times the same part of the reading, now and then."""
    scene, cause, change = change_of("lost_in_mean", 1)
    part = -to_nanotesla(change) * scene.intensity_T.mean() / scene.readings_T[:, cause.sensors[0] - 1]
    np.testing.assert_allclose(part, np.repeat(np.round(part[:, :1]), 3, axis=1), atol=1e-9)
    assert 0 < (part > 0.5).mean() < 0.2


def test_a_current_flows_while_the_joints_are_unlike(change_of):
    """It follows the change of the air's temperature more than the temperature itself."""
    scene, _, change = change_of("seebeck_loop", 1)
    course, air_C = change[:, np.abs(change).max(axis=0).argmax()], scene.temperature(scene.time_s)
    alike = [abs(np.corrcoef(course, one)[0, 1]) for one in (np.gradient(air_C, scene.time_s), air_C)]
    assert alike[0] > 0.7 and alike[0] > alike[1]


def test_an_arm_lies_at_its_stop_until_it_is_tilted(draw):
    """Until then its error is a constant turn; afterwards it is another."""
    scene = draw(1)

    def of_level(time_s):
        return np.outer(time_s, [0.3, 0, 0])

    for turning, turned_once in ((scene, False), (replace(scene, motion=ContinuousMotion("tumbling", of_level)), True)):
        vectors, _ = SIXTH["folding_arms"].draw(np.random.default_rng(1), turning).change(1.0, ())
        left = np.linalg.lstsq(turning.core(0), vectors[:, 0], rcond=None)[0]
        assert np.allclose(turning.core(0) @ left, vectors[:, 0], atol=1e-6 * np.abs(vectors).max()) == turned_once


def test_a_hum_makes_the_intensity_larger(draw):
    """By the square of the current, and never by less than nothing."""
    scene = draw(1)
    vectors, scalar = SIXTH["rectified_hum"].draw(np.random.default_rng(1), scene).change(1.0, ())
    most = 1e-9 * (scene.current(scene.time_s) / scene.current(scene.time_s).max()) ** 2
    assert not vectors.any() and (scalar >= 0).all() and (scalar <= most).all() and scalar.max() > 0.5e-9


def test_a_line_is_changed_in_the_dark(draw):
    """The scalar errs by whole distances of lines, and for long by the same one."""
    scene = draw(1)
    _, scalar = SIXTH["next_line"].draw(np.random.default_rng(1), scene).change(1.0, ())
    lines = np.abs(to_nanotesla(scalar))
    assert set(np.round(lines, 9)) == {0.0, 1.0, 2.0} or set(np.round(lines, 9)) == {0.0, 1.0}
    assert 0 < np.mean(np.diff(lines) != 0) < 0.1


def test_an_old_hull_follows_slowly(draw):
    """From one sample to the next its field changes by a small part of all that it does."""
    scene = draw(1)
    vectors, _ = SIXTH["viscous_hull"].draw(np.random.default_rng(1), scene).change(1.0, ())
    assert np.abs(np.diff(vectors, axis=0)).max() < 0.1 * np.ptp(vectors, axis=0).max()
