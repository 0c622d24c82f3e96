"""The thirteenth, the fourteenth and the fifteenth set of causes outside the library."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.units import to_nanotesla
from tam_validation.blind import SETS
from tam_validation.blind.case_plan import plan_cases
from tam_validation.blind.catalogue import CATALOGUE, CAUSES, LAWS, OUTSIDE_SETS
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.outside_fifteenth import FIFTEENTH
from tam_validation.blind.outside_fourteenth import FOURTEENTH
from tam_validation.blind.outside_thirteenth import THIRTEENTH

COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}
KINDS_OF_LAW = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}


def test_the_sets_share_no_name():
    """Neither with each other nor with the library."""
    names = [name for one in (CATALOGUE, *OUTSIDE_SETS.values()) for name in one]
    assert tuple(OUTSIDE_SETS) == SETS and len(names) == len(set(names)) == len(CAUSES)


@pytest.mark.parametrize("name", [*THIRTEENTH, *FOURTEENTH, *FIFTEENTH])
def test_every_cause_has_a_law_and_a_course(name):
    """Of those that there are."""
    right = LAWS[name]
    assert right["law"] and right["course"]
    assert set(right["law"]) <= KINDS_OF_LAW and set(right["course"]) <= COURSES


def test_every_law_is_in_a_set():
    """Each is the usual one of some cause, and most courses are."""
    assert {LAWS[name]["law"][0] for name in THIRTEENTH} == KINDS_OF_LAW
    assert len({LAWS[name]["course"][0] for name in THIRTEENTH}) >= 7


@pytest.mark.parametrize("causes", [FOURTEENTH, FIFTEENTH])
def test_a_small_set_has_no_law_twice(causes):
    """Six causes are of six laws, and of four courses."""
    assert len({LAWS[name]["law"][0] for name in causes}) == len(causes) == 6
    assert len({LAWS[name]["course"][0] for name in causes}) >= 4


@pytest.mark.parametrize("name", SETS)
def test_a_plan_draws_from_one_set(name):
    """All causes of the set, and of no other; mixtures take those that leave a sensor to another cause."""
    single = {plan.effects[0] for plan in plan_cases(("outside",), 60, 3, name)}
    mixed = plan_cases(("mixed",), 120, 3, name)
    assert single == set(OUTSIDE_SETS[name]) and len(mixed) == 120
    beside = {plan.effects[1] for plan in mixed}
    everywhere = {"rising_barge", "breathing_diver", "shifted_battery"}
    assert beside == single - everywhere - {"emptying_bottle", "belt_drive"}


def test_a_barge_rises_beside_the_array(draw):
    """At one attitude its field changes in one piece, smoothly, and stays once the lock is full."""
    scene = draw(1, samples=1000)
    still = replace(scene, motion=ContinuousMotion("turntable", lambda time_s: np.full((len(time_s), 3), 0.4)))
    vectors, scalar = THIRTEENTH["rising_barge"].draw(np.random.default_rng(1), still).change(1.0, ())
    steps = np.abs(np.diff(to_nanotesla(vectors).reshape(scene.sample_count, -1), axis=0)).max(axis=1)
    assert scalar.any() and steps.max() < 0.05 * np.ptp(to_nanotesla(vectors), axis=0).max()
    assert np.count_nonzero(np.diff(steps > 1e-9 * steps.max())) <= 2


def test_a_bottle_moves_with_each_breath(draw):
    """All sensors have the tone of the breath, and the scalar too, whichever way the diver turns."""
    scene = draw(1, samples=1000)
    cause = THIRTEENTH["breathing_diver"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    values = np.linalg.svd(vectors.reshape(scene.sample_count, -1), full_matrices=False)[0][:, 0]
    power = np.abs(np.fft.rfft(values - values.mean())) ** 2
    assert abs(power.argmax() - scene.duration_s / cause.parameters["breath_s"]) < 3 and scalar.any()
    assert vectors.any(axis=(0, 2)).all()


def test_a_winding_is_detuned_by_its_warmth(change_of):
    """Each axis gains a part of its reading that has a hill over the temperature."""
    scene, cause, change = change_of("detuned_pickup", 1)
    core = scene.core(cause.sensors[0] - 1)
    axis = int(np.abs(change).max(axis=0).argmax())
    gain = to_nanotesla(change[:, axis]) / core[:, axis]
    assert (gain > 0).all() and (gain <= 1 + 1e-9).all() and np.ptp(gain) > 0.1
    assert np.abs(np.diff(gain)).max() < 0.1 * np.ptp(gain)


def test_a_potting_is_squeezed_in_dives(change_of):
    """The three axes have their own part of their reading, and one course, which returns to nothing."""
    scene, cause, change = change_of("squeezed_potting", 1)
    gain = to_nanotesla(change) / scene.core(cause.sensors[0] - 1)
    sizes = np.linalg.svd(gain, compute_uv=False)
    assert sizes[1] < 1e-6 * sizes[0]
    course = np.abs(gain).max(axis=1) / np.abs(gain).max()
    assert 0.02 < (course < 0.1).mean() < 0.98 and np.abs(np.diff(course)).max() < 0.5


def test_a_cable_is_later_and_later(draw):
    """One sensor alone, and never less late than before."""
    scene = draw(2, motions=("diver",))
    cause = THIRTEENTH["waterlogged_cable"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-5, ())
    sensor = cause.sensors[0] - 1
    rate = (scene.readings_T - scene.readings_at(scene.time_s - 1e-5))[:, sensor]
    late = -(vectors[:, sensor] * rate).sum(axis=1) / (rate**2).sum(axis=1)
    assert (np.diff(late) > -0.01).all() and late[-1] > 0.7 and not np.delete(vectors, sensor, axis=1).any()


def test_a_loop_holds_the_rate_of_one_component(change_of):
    """Of the field in the array's frame, at all times alike."""
    scene, _, change = change_of("pickup_loop", 1, motions=("diver",))
    rate = scene.field_at(scene.time_s + 1e-4) - scene.field_at(scene.time_s - 1e-4)
    left = change - rate @ np.linalg.lstsq(rate, change, rcond=None)[0]
    assert np.abs(left).max() < 0.01 * np.abs(change).max()
    assert np.linalg.matrix_rank(change, 1e-6 * np.linalg.norm(change)) == 1


def test_short_numbers_are_coarser_where_they_are_larger(draw):
    """A reading is rounded by half a step at most; the step of large ones is a multiple of that of small ones."""
    scene = draw(1, samples=2000)
    cause = THIRTEENTH["half_precision"].draw(np.random.default_rng(1), scene)
    step_T = 1e-7
    vectors, _ = cause.change(step_T, (scene.readings_T, scene.intensity_T))
    sent = [sensor - 1 for sensor in cause.sensors]
    error, size = np.abs(vectors[:, sent]), np.abs(scene.readings_T[:, sent])
    large, small = size > np.quantile(size, 0.9), size < np.quantile(size, 0.1)
    assert error.max() <= step_T / 2 and error[large].mean() > 2.5 * error[small].mean()
    assert not np.delete(vectors, sent, axis=1).any()


def test_a_hum_is_a_tone_of_the_scalar(draw):
    """Of the scalar alone, near the frequency at which it is seen."""
    scene = draw(1, samples=1000)
    cause = THIRTEENTH["generator_hum"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    power = np.abs(np.fft.rfft(scalar)) ** 2
    assert abs(power.argmax() - scene.duration_s / cause.parameters["swing_s"]) < 3 and not vectors.any()


def test_light_of_the_other_hand_shifts_the_other_way(draw):
    """The scalar errs by one component of the field's direction, whose sign changes at each start."""
    scene = draw(1)
    cause = THIRTEENTH["reversed_polarisation"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    unit, count = scene.field_T / scene.intensity_T[:, None], scene.sample_count
    beam = np.linalg.lstsq(unit[: count // 5], scalar[: count // 5], rcond=None)[0]
    hand = np.sign(scalar * (unit @ beam))
    assert np.count_nonzero(np.diff(hand)) == cause.parameters["starts"] and not vectors.any()
    np.testing.assert_allclose(np.abs(scalar), np.abs(unit @ beam), atol=1e-15)


def test_domains_jump_while_the_field_changes(change_of):
    """Noise whose power goes with how fast the reading of the axis changes."""
    scene, cause, change = change_of("barkhausen_jumps", 1, samples=2000, motions=("diver",))
    axis = int(np.abs(change).max(axis=0).argmax())
    reading = scene.readings_T[:, cause.sensors[0] - 1, axis]
    order = np.argsort(np.abs(np.gradient(reading)))
    power = [np.mean(change[part, axis] ** 2) for part in np.array_split(order, 4)]
    assert (np.diff(power) > 0).all() and power[-1] > 5 * power[0]


def test_a_switch_pulses_as_it_is_tilted(change_of):
    """One reading each, this way and that way in turn, and along one line."""
    scene, _, change = change_of("tilt_switch", 1, samples=2000)
    struck = np.flatnonzero(change.any(axis=1))
    assert 2 <= len(struck) < 0.1 * scene.sample_count
    assert np.linalg.matrix_rank(change, 1e-6 * np.linalg.norm(change)) == 1
    signs = np.sign(change[struck] @ change[struck[0]])
    np.testing.assert_array_equal(signs, (-1.0) ** np.arange(len(struck)))


def test_a_screen_lets_out_what_is_beyond_its_most(draw):
    """Nothing below some current; above it a line in the current."""
    scene = draw(1)
    cause = THIRTEENTH["saturated_screen"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    near, load_A = [sensor - 1 for sensor in cause.sensors], scene.current(scene.time_s)
    out = vectors[:, near].any(axis=(1, 2))
    assert 0.2 < out.mean() < 0.9 and load_A[out].min() > load_A[~out].max() and not scalar.any()
    size = to_nanotesla(np.linalg.norm(vectors[out][:, near], axis=2))
    slope, crossing = np.polyfit(load_A[out], size[:, 0], 1)
    np.testing.assert_allclose(size[:, 0], slope * load_A[out] + crossing, atol=1e-9)
    assert not np.delete(vectors, near, axis=1).any()


def test_firmware_takes_the_middle_of_its_latest_extremes(change_of):
    """Nothing at first; then each level is the middle of what the sensor read since the level before."""
    scene, cause, change = change_of("relearned_offset", 1)
    core, level = scene.core(cause.sensors[0] - 1), -to_nanotesla(change)
    cuts = np.flatnonzero(np.diff(level, axis=0).any(axis=1)) + 1
    assert 5 <= len(cuts) <= 9 and not level[: cuts[0]].any()
    for part, cut in zip(np.split(core, cuts), cuts, strict=False):
        np.testing.assert_allclose(level[cut], (part.max(axis=0) + part.min(axis=0)) / 2)


def test_a_tail_strikes_a_reading_soon_after_a_pulse(change_of):
    """Few readings, along one line and to one side of it, and about as many samples apart each time."""
    scene, _, change = change_of("set_pulse_tail", 1, samples=2000)
    struck = np.flatnonzero(np.abs(change).max(axis=1) > 0.5 * np.abs(change).max())
    assert 5 <= np.count_nonzero(change.any(axis=1)) < 0.2 * scene.sample_count
    assert np.linalg.matrix_rank(change, 1e-6 * np.linalg.norm(change)) == 1
    assert (change[struck] @ change[struck[0]] > 0).all() and np.diff(struck).min() >= 13


def test_a_filter_is_slow_at_rest(draw):
    """Some sensors are late by one time, the less the faster the array turns."""
    scene = draw(2, motions=("diver",))
    cause = FOURTEENTH["adaptive_smoothing"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-5, ())
    smoothed = [sensor - 1 for sensor in cause.sensors]
    rate = (scene.readings_T - scene.readings_at(scene.time_s - 1e-5))[:, smoothed]
    late = -(vectors[:, smoothed] * rate).sum(axis=2) / (rate**2).sum(axis=2)
    np.testing.assert_allclose(late, np.repeat(late[:, :1], len(smoothed), axis=1), rtol=0.02)
    order = np.argsort(np.linalg.norm(scene.motion.turning_rate(scene.time_s, scene.step_s / 50), axis=1))
    assert late[order[0], 0] > 3 * late[order[-1], 0] and late.mean() == pytest.approx(1, rel=0.05)
    assert not np.delete(vectors, smoothed, axis=1).any()


def test_daylight_is_noise_at_the_surface(draw):
    """The scalar alone is noisy at times, and quiet in the deep."""
    scene = draw(1, samples=2000)
    vectors, scalar = FOURTEENTH["surfacing_daylight"].draw(np.random.default_rng(1), scene).change(1.0, ())
    loud = np.sort([part.std() for part in np.array_split(scalar, 40)])
    assert loud[-1] > 10 * loud[0] and not vectors.any()
    assert abs(np.corrcoef(scalar[1:], scalar[:-1])[0, 1]) < 0.1


def test_a_bottle_is_magnetised_less_as_it_empties(draw):
    """At one attitude all sensors change along one course, which never turns back; a turn of the array changes it."""
    scene = draw(1)
    still = replace(scene, motion=ContinuousMotion("turntable", lambda time_s: np.full((len(time_s), 3), 0.4)))
    cause = FOURTEENTH["emptying_bottle"].draw(np.random.default_rng(1), still)
    vectors, scalar = cause.change(1.0, ())
    course = vectors[:, 0, 0] / vectors[-1, 0, 0]
    np.testing.assert_allclose(vectors, course[:, None, None] * vectors[-1], rtol=0.01)
    assert (np.diff(course) > 0).all() and scalar.any()
    turning = FOURTEENTH["emptying_bottle"].draw(np.random.default_rng(1), scene).change(1.0, ())[0]
    assert np.linalg.matrix_rank(turning[:, 0], 1e-3 * np.linalg.norm(turning[:, 0])) == 3


def test_a_shaft_turns_with_the_table(draw):
    """Turned once around, the array meets the shaft at another angle, unless one pulley has a multiple of the teeth."""
    scene = draw(1, samples=1000)

    def angles(time_s):
        return np.outer(4 * np.pi * time_s / scene.duration_s, [1.0, 0, 0])

    turned = replace(scene, motion=ContinuousMotion("turntable", angles), time_s=np.linspace(0, scene.duration_s, 1001))
    cause = FOURTEENTH["belt_drive"].draw(np.random.default_rng(1), turned)
    vectors, scalar = cause.change(1e-3, ())
    ratio = cause.parameters["teeth_driven"] / cause.parameters["teeth_driving"]
    again = np.linalg.norm(vectors[500, 0] - vectors[0, 0]) / np.linalg.norm(vectors[0, 0])
    assert scalar.any() and vectors.any(axis=(0, 2)).all()
    assert (again > 0.05) == (abs(ratio - round(ratio)) > 0.01)


def test_a_carousel_holds_one_of_few_fields(change_of):
    """Each next one is the one before, turned in the plane of the two windings by as much each time."""
    _, _, change = change_of("sampling_carousel", 2)
    moved = np.flatnonzero(np.diff(change, axis=0).any(axis=1))
    levels = to_nanotesla(change[np.append(moved, len(change) - 1)])
    assert 6 <= len(moved) <= 12 and np.linalg.matrix_rank(levels, 1e-6) <= 2
    assert len(np.unique(np.round(levels, 6), axis=0)) <= 8
    sums = levels[2:] + levels[:-2]  # 2 cos(step) times the level between
    ratio = (sums * levels[1:-1]).sum() / (levels[1:-1] ** 2).sum()
    np.testing.assert_allclose(sums, ratio * levels[1:-1], atol=1e-9)


def test_an_arm_lags_by_the_square_of_the_rate(draw):
    """In a turn that is faster and faster the delay grows with the rate."""
    scene = draw(1)

    def angles(time_s):
        return np.outer(6 * (time_s / scene.duration_s) ** 2, [1.0, 0, 0])

    turned = replace(scene, motion=ContinuousMotion("tumbling", angles))
    cause = FIFTEENTH["dragged_arm"].draw(np.random.default_rng(1), turned)
    vectors, scalar = cause.change(1.0, ())
    sensor = cause.sensors[0] - 1
    change, late = vectors[100:, sensor], (turned.readings_at(turned.time_s - 1e-3) - turned.readings_T)[100:, sensor]
    sizes = np.linalg.norm(change, axis=1), np.linalg.norm(late, axis=1)
    growth = sizes[0] / sizes[1] / turned.time_s[100:]
    assert ((change * late).sum(axis=1) / sizes[0] / sizes[1] > 0.7).all() and growth.std() < 0.3 * growth.mean()
    assert not np.delete(vectors, sensor, axis=1).any() and not scalar.any()


def test_a_converter_is_loud_at_a_light_load(draw):
    """Noise in all that it feeds, and only below some current."""
    scene = draw(1)
    cause = FIFTEENTH["skipping_converter"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    fed, load_A = [sensor - 1 for sensor in cause.sensors], scene.current(scene.time_s)
    loud = vectors[:, fed].any(axis=2)
    assert (loud == loud[:, :1]).all() and 0.2 < loud[:, 0].mean() < 0.65 and not scalar.any()
    assert load_A[loud[:, 0]].max() < load_A[~loud[:, 0]].min() and not np.delete(vectors, fed, axis=1).any()


def test_a_card_writes_block_by_block(draw):
    """After as many samples each time some sensors hold a surge, along one line each."""
    scene = draw(1, samples=2000)
    cause = FIFTEENTH["card_writes"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    near = [sensor - 1 for sensor in cause.sensors]
    struck = vectors[:, near[0]].any(axis=1)
    starts = np.flatnonzero(np.diff(struck.astype(int)) == 1)
    assert (np.diff(starts) == cause.parameters["block"]).all() and len(starts) > 30 and struck.mean() < 0.1
    assert all(np.linalg.matrix_rank(to_nanotesla(vectors[:, one]), 1e-6) == 1 for one in near)
    assert not np.delete(vectors, near, axis=1).any() and not scalar.any()


def test_sand_clings_more_and_more(draw):
    """Each housing adds one matrix of the field, times a course that all have and that never turns back."""
    scene = draw(1)
    cause = FIFTEENTH["clinging_sand"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1.0, ())
    soiled = [sensor - 1 for sensor in cause.sensors]
    still = replace(scene, motion=ContinuousMotion("turntable", lambda time_s: np.full((len(time_s), 3), 0.4)))
    rest = to_nanotesla(FIFTEENTH["clinging_sand"].draw(np.random.default_rng(1), still).change(1.0, ())[0])
    course = np.linalg.norm(rest[:, soiled[0]], axis=1)
    assert (np.diff(course) > 0).all() and not np.delete(vectors, soiled, axis=1).any()
    for one in soiled:
        tensor = np.linalg.lstsq(scene.field_T * course[:, None], vectors[:, one], rcond=None)[0]
        left = vectors[:, one] - scene.field_T * course[:, None] @ tensor
        assert np.abs(left).max() < 1e-3 * np.abs(vectors[:, one]).max()


def test_a_battery_lies_where_the_pitch_wants_it(draw):
    """The same attitude brings the same field back, whatever the heading; all sensors and the scalar have it."""
    scene = draw(1)
    headings = []
    for turns in (0.0, 3.0):

        def angles(time_s, turns=turns):
            swing = np.sin(2 * np.pi * time_s / scene.duration_s)
            return np.stack([turns * time_s / scene.duration_s, 0.6 * swing, 0.4 * swing], axis=1)

        turned = replace(scene, motion=ContinuousMotion("tumbling", angles))
        vectors, scalar = FIFTEENTH["shifted_battery"].draw(np.random.default_rng(1), turned).change(1.0, ())
        headings.append(to_nanotesla(vectors))
        assert scalar.any() and vectors.any(axis=(0, 2)).all() and np.ptp(headings[-1], axis=0).max() > 1
    np.testing.assert_allclose(headings[0], headings[1], atol=1e-9)
