"""The second, the fourth and the fifth set of causes outside the library."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.units import to_nanotesla
from tam_validation.blind import SETS
from tam_validation.blind.case_plan import plan_cases
from tam_validation.blind.catalogue import CATALOGUE, CAUSES, LAWS, OUTSIDE_SETS
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.outside_fifth import FIFTH
from tam_validation.blind.outside_fourth import FOURTH
from tam_validation.blind.outside_second import SECOND

COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}
KINDS_OF_LAW = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}


def test_the_sets_share_no_name():
    """Neither with each other nor with the library."""
    names = [name for one in (CATALOGUE, *OUTSIDE_SETS.values()) for name in one]
    assert tuple(OUTSIDE_SETS) == SETS and len(names) == len(set(names)) == len(CAUSES)


@pytest.mark.parametrize("name", [*SECOND, *FOURTH, *FIFTH])
def test_every_cause_has_a_law_and_a_course(name):
    """Of those that there are."""
    right = LAWS[name]
    assert right["law"] and right["course"]
    assert set(right["law"]) <= KINDS_OF_LAW and set(right["course"]) <= COURSES


@pytest.mark.parametrize("causes", [SECOND, FOURTH, FIFTH])
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
    everywhere = {"proton_polarisation", "solar_panel", "swapped_pack"}
    assert beside == single - everywhere - {"moist_boards", "walking_operator", "arc_welder"}


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


def test_a_long_average_is_nearer_to_the_middle(change_of):
    """A turning vector's mean is shorter than the vector, by the square of the window."""
    scene, cause, change = change_of("long_average", 2, amplitude=1.0)
    sensor = cause.sensors[0] - 1
    size = {square: np.abs(change_of("long_average", 2, amplitude=square)[2]).max() for square in (1e-4, 2e-4)}
    assert size[2e-4] == pytest.approx(2 * size[1e-4], rel=0.05)
    assert np.sum(change * scene.core(sensor)) < 0


def test_a_switch_snaps_back_later_than_it_snapped(change_of):
    """When snapped it is never cool, when not it is never warm."""
    scene, _, change = change_of("bimetal_snap", 3)
    snapped, air_C = np.linalg.norm(change, axis=1) > 0, scene.temperature(scene.time_s)
    assert 0 < snapped.mean() < 1
    assert air_C[~snapped].max() > air_C[snapped].min(), "between the two it is as it was"
    assert air_C.argmax() in np.flatnonzero(snapped) and air_C.argmin() not in np.flatnonzero(snapped)


def test_flipped_bits_are_whole_bits(draw):
    """Each error is a power of two of the least bit, of either sign, in a few readings."""
    scene = draw(1)
    cause = FOURTH["bit_flips"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1e-9, (scene.readings_T, scene.intensity_T))
    flipped = to_nanotesla(vectors[vectors != 0])
    assert 0 < len(flipped) < 0.2 * scene.sample_count
    np.testing.assert_allclose(np.log2(np.abs(flipped)), np.round(np.log2(np.abs(flipped))), atol=1e-6)


def test_a_wound_tether_turns_a_sensor(change_of):
    """What is turned by little changes across itself: it keeps its size."""
    scene, cause, change = change_of("wound_tether", 1)
    core = scene.core(cause.sensors[0] - 1)
    np.testing.assert_allclose(np.sum(change * core, axis=1), 0, atol=1e-20)


def test_a_pulse_sets_all_domains_again(change_of):
    """Some sensitivity is lost for a part of the time, and each time it comes back."""
    scene, cause, change = change_of("flipped_domains", 1)
    core = scene.core(cause.sensors[0] - 1)
    lost = np.linalg.norm(change, axis=1) > 0
    assert 0.02 < lost.mean() < 0.6 and np.sum(np.diff(lost.astype(int)) == 1) >= 2
    assert (np.sum(change * core, axis=1) <= 0).all()


def test_who_walks_around_yaws_along(draw):
    """While the array is not tilted, the iron in the pockets stays at one place beside it."""
    scene = draw(1)

    def angles(time_s):
        return np.outer(time_s, [0.3, 0, 0]) + np.outer(time_s > scene.duration_s / 2, [0, 0.5, 0])

    turning = replace(scene, motion=ContinuousMotion("tumbling", angles))
    vectors, _ = FIFTH["walking_operator"].draw(np.random.default_rng(1), turning).change(1.0, ())
    level = scene.time_s < scene.duration_s / 2
    assert np.ptp(vectors[level], axis=0).max() < 1e-6 * np.ptp(vectors, axis=0).max()
