"""The fourteenth, the fifteenth and the sixteenth set of causes outside the library."""

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
from tam_validation.blind.outside_sixteenth import SIXTEENTH

COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}
KINDS_OF_LAW = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}


def test_the_sets_share_no_name():
    """Neither with each other nor with the library."""
    names = [name for one in (CATALOGUE, *OUTSIDE_SETS.values()) for name in one]
    assert tuple(OUTSIDE_SETS) == SETS and len(names) == len(set(names)) == len(CAUSES)


@pytest.mark.parametrize("name", [*FOURTEENTH, *FIFTEENTH, *SIXTEENTH])
def test_every_cause_has_a_law_and_a_course(name):
    """Of those that there are."""
    right = LAWS[name]
    assert right["law"] and right["course"]
    assert set(right["law"]) <= KINDS_OF_LAW and set(right["course"]) <= COURSES


def test_every_law_is_in_a_set():
    """Each is the usual one of some cause, and most courses are."""
    assert {LAWS[name]["law"][0] for name in SIXTEENTH} == KINDS_OF_LAW
    assert len({LAWS[name]["course"][0] for name in SIXTEENTH}) >= 7


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
    assert beside == single - {"emptying_bottle", "belt_drive", "shifted_battery", "dropped_ballast"}


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


def test_two_exciters_beat(draw):
    """Two sensors have the tone of the beat and nothing else has; the stronger the pull, the more overtones."""
    scene = draw(1, samples=1000)
    cause = SIXTEENTH["beating_exciters"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    pair = [sensor - 1 for sensor in cause.sensors]
    assert len(pair) == 2 and not np.delete(vectors, pair, axis=1).any() and not scalar.any()
    for one in pair:
        power = np.abs(np.fft.rfft(vectors[:, one] - vectors[:, one].mean(axis=0), axis=0)) ** 2
        assert (np.abs(power.argmax(axis=0) - scene.duration_s / cause.parameters["beat_s"]) < 3).all()


def test_a_solenoid_is_on_while_its_valve_is_open(draw):
    """All near sensors follow one course, with a level for open and one for shut, but for the moments of pull-in."""
    scene = draw(1, samples=1000)
    cause = SIXTEENTH["valve_solenoid"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    near = [sensor - 1 for sensor in cause.sensors]
    together = to_nanotesla(vectors[:, near]).reshape(scene.sample_count, -1)
    assert np.linalg.matrix_rank(together, 1e-6) == 1
    course = np.abs(together).max(axis=1)
    levels, counts = np.unique(np.round(course, 9), return_counts=True)
    assert len(levels) <= 4 and counts.max() < 0.9 * scene.sample_count
    opened = course > 0.5 * np.median(course[course > 0.3 * course.max()])
    assert np.count_nonzero(np.diff(opened.astype(int)) == 1) == cause.parameters["openings"] - opened[0]
    assert not np.delete(vectors, near, axis=1).any() and not scalar.any()


def test_a_weight_is_there_until_it_is_dropped(draw):
    """At one attitude the field of all stays, falls within seconds at each drop, and is none once all are gone."""
    scene = draw(1, samples=2000)
    still = replace(scene, motion=ContinuousMotion("tumbling", lambda time_s: np.full((len(time_s), 3), 0.2)))
    for seed in range(4):
        cause = SIXTEENTH["dropped_ballast"].draw(np.random.default_rng(seed), still)
        vectors, scalar = cause.change(1.0, ())
        drops_s = np.array(cause.parameters["drops_s"])
        assert scalar.any() and vectors.any(axis=(0, 2)).all()
        size = to_nanotesla(np.linalg.norm(vectors, axis=(1, 2)))
        assert np.ptp(size[still.time_s < drops_s[0]]) < 1e-2 * size[0]
        steps = np.abs(np.diff(to_nanotesla(vectors), axis=0)).max(axis=(1, 2)) / size.max()
        quiet = ((still.time_s[1:, None] < drops_s) | (still.time_s[1:, None] > drops_s + 5)).all(axis=1)
        assert steps[quiet].max(initial=0) < 0.02


def test_a_weight_falls_clear_of_the_array(draw):
    """However the array turns, no sensor meets more of a weight once it is dropped than while it hung there."""
    scene = draw(2, samples=2000, motions=("diver",))
    for seed in range(6):
        cause = SIXTEENTH["dropped_ballast"].draw(np.random.default_rng(seed), scene)
        size = np.linalg.norm(cause.change(1.0, ())[0], axis=2).max(axis=1)
        before = scene.time_s < cause.parameters["drops_s"][0]
        assert size[~before].max() < 1.5 * size[before].max()


def test_a_reference_droops_with_the_load(draw):
    """All axes that it converts gain the same part of their reading, which follows the current."""
    scene = draw(1)
    cause = SIXTEENTH["drooping_reference"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    converted = [sensor - 1 for sensor in cause.sensors]
    gain = vectors[:, converted] / scene.readings_T[:, converted]
    np.testing.assert_allclose(gain, np.broadcast_to(gain[:, :1, :1], gain.shape), rtol=1e-9)
    assert np.corrcoef(gain[:, 0, 0], scene.current(scene.time_s))[0, 1] > 0.8
    assert not np.delete(vectors, converted, axis=1).any() and not scalar.any()


def test_vortices_tilt_a_sensor_to_and_fro(change_of):
    """The change is across the field; the tilt goes to and fro many times, and is none on the mean."""
    scene, cause, change = change_of("shedding_vortices", 1, samples=1000)
    response, arm = (part[cause.sensors[0] - 1] for part in (scene.response, scene.positions_m))
    turned = to_nanotesla(np.linalg.solve(response, change.T).T)
    assert np.abs((turned * scene.field_T).sum(axis=1) / scene.intensity_T).max() < 1e-6
    across = turned @ arm / np.linalg.norm(arm)
    assert abs(across.mean()) < 0.1 * across.std()
    assert np.count_nonzero(np.diff(np.sign(across))) > 0.05 * scene.sample_count


def test_a_multiplexer_comes_to_each_axis_in_turn(draw):
    """Each axis is read as much after the one before, the first of all in time."""
    scene = draw(2, motions=("diver",))
    cause = SIXTEENTH["swept_multiplexer"].draw(np.random.default_rng(2), scene)
    vectors, scalar = cause.change(1e-5, ())
    swept = [sensor - 1 for sensor in cause.sensors]
    rate = (scene.readings_at(scene.time_s + 1e-5) - scene.readings_T)[:, swept].reshape(scene.sample_count, -1)
    change = vectors[:, swept].reshape(scene.sample_count, -1)
    delays = (change * rate).sum(axis=0) / (rate**2).sum(axis=0)
    np.testing.assert_allclose(delays, cause.parameters["turns"], atol=0.02)
    assert sorted(cause.parameters["turns"]) == list(range(3 * len(swept)))
    assert not np.delete(vectors, swept, axis=1).any() and not scalar.any()


def test_a_washer_drives_less_and_less(change_of):
    """One direction, one sign and one course, without steps; most end lower than they begin, whatever the flow."""
    ends = []
    for seed in range(10):
        _, _, change = change_of("galvanic_washer", seed, samples=1000)
        assert np.linalg.matrix_rank(change, 1e-6 * np.linalg.norm(change)) == 1
        course = change @ change[0] / (change[0] @ change[0])
        assert (course > 0).all() and np.abs(np.diff(course)).max() < 0.05
        ends.append(course[-1])
    assert np.median(ends) < 0.8


def test_a_feedback_falls_behind_in_quick_turns(draw):
    """Where an axis changes slowly for long, its reading is right; where it changes fastest, it is late."""
    scene = draw(2, samples=2000, motions=("diver",))
    cause = SIXTEENTH["slewing_feedback"].draw(np.random.default_rng(2), scene)
    vectors, scalar = cause.change(0.3, ())
    sensor = cause.sensors[0] - 1
    rate = scene.readings_at(scene.time_s + 1e-4) - scene.readings_at(scene.time_s - 1e-4)
    axes = np.flatnonzero(vectors[:, sensor].any(axis=0))
    change, rate = vectors[:, sensor, axes], rate[:, sensor, axes]
    late = np.abs(change) > 1e-3 * np.abs(change).max()
    fastest = np.abs(rate) > 0.9 * np.abs(rate).max()
    assert 0 < late.mean() < 0.5 and late[fastest].all()
    assert (change * rate)[fastest].max() < 0
    assert not np.delete(vectors, sensor, axis=1).any() and not scalar.any()


def test_a_kink_is_where_no_transistor_conducts(change_of):
    """The error is a function of the axis' own reading: one level for each sign, and a steep way between."""
    scene, cause, change = change_of("crossover_distortion", 1, samples=2000)
    axis = int(np.abs(change).max(axis=0).argmax())
    reading = scene.readings_T[:, cause.sensors[0] - 1, axis] / scene.intensity_T.mean()
    error = change[np.argsort(reading), axis]
    assert (np.diff(error) <= 1e-18).all()
    far = np.abs(reading) > 0.4
    np.testing.assert_allclose(np.abs(change[far, axis]), np.abs(change[:, axis]).max(), rtol=0.01)
    assert change[far, axis].min() < 0 < change[far, axis].max()


def test_a_ribbon_at_the_cell_saturates(draw):
    """The scalar alone errs, by a function of the field's direction that no polynomial of low order is."""
    scene = draw(1, samples=2000)
    cause = SIXTEENTH["ribbon_at_cell"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    unit = scene.field_T / scene.intensity_T[:, None]
    assert not vectors.any() and to_nanotesla(np.abs(scalar).max()) <= 1
    quadratic = np.einsum("ni,nj->nij", unit, unit).reshape(len(unit), -1)
    cubic = np.einsum("ni,nj->nij", quadratic, unit).reshape(len(unit), -1)
    basis = np.column_stack([unit, quadratic, cubic])
    left = scalar - basis @ np.linalg.lstsq(basis, scalar, rcond=None)[0]
    assert 0.01 * scalar.std() < left.std() < 0.5 * scalar.std()
    np.testing.assert_allclose(cause.change(2.0, ())[1], 2 * scalar, rtol=1e-3, atol=1e-3 * np.abs(scalar).max())


def test_a_torn_word_errs_by_a_lower_byte(draw):
    """Few readings, none by more than a lower byte, and those that err by much by nearly one."""
    scene = draw(1, samples=4000)
    cause = SIXTEENTH["torn_bytes"].draw(np.random.default_rng(1), scene)
    byte_T = 1e-5
    vectors, scalar = cause.change(byte_T, (scene.readings_T, scene.intensity_T))
    sensor = cause.sensors[0] - 1
    error = np.abs(vectors[:, sensor])
    moved = np.abs(scene.readings_at(scene.time_s - cause.parameters["age_s"]) - scene.readings_T)[:, sensor]
    most_T = moved.max() + 6 * scene.vector_noise_T
    assert error.max() <= byte_T and 0 < (error > 0).mean() < 0.15
    carried = error > most_T
    assert carried.any() and error[carried].min() > byte_T - most_T
    assert not np.delete(vectors, sensor, axis=1).any() and not scalar.any()


def test_precession_is_counted_badly_along_the_coil(draw):
    """The scalar alone is noisy, at some angles ten times as much as at others, and without memory."""
    scene = draw(1, samples=4000)
    vectors, scalar = SIXTEENTH["weak_precession"].draw(np.random.default_rng(1), scene).change(1.0, ())
    unit = scene.field_T / scene.intensity_T[:, None]
    products = np.stack([unit[:, i] * unit[:, j] for i in range(3) for j in range(i, 3)], axis=1)
    power = products @ np.linalg.lstsq(products, scalar**2, rcond=None)[0]
    order = np.argsort(power)
    loud = [scalar[part].std() for part in np.array_split(order, 8)]
    assert loud[-1] > 5 * loud[0] and not vectors.any()
    assert abs(np.corrcoef(scalar[1:], scalar[:-1])[0, 1]) < 0.1
