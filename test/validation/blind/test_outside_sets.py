"""The ninth, the tenth and the eleventh set of causes outside the library."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.units import to_nanotesla
from tam_validation.blind import SETS
from tam_validation.blind.case_plan import plan_cases
from tam_validation.blind.catalogue import CATALOGUE, CAUSES, LAWS, OUTSIDE_SETS
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.outside_eleventh import ELEVENTH
from tam_validation.blind.outside_ninth import NINTH
from tam_validation.blind.outside_tenth import TENTH

COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}
KINDS_OF_LAW = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}


def test_the_sets_share_no_name():
    """Neither with each other nor with the library."""
    names = [name for one in (CATALOGUE, *OUTSIDE_SETS.values()) for name in one]
    assert tuple(OUTSIDE_SETS) == SETS and len(names) == len(set(names)) == len(CAUSES)


@pytest.mark.parametrize("name", [*NINTH, *TENTH, *ELEVENTH])
def test_every_cause_has_a_law_and_a_course(name):
    """Of those that there are."""
    right = LAWS[name]
    assert right["law"] and right["course"]
    assert set(right["law"]) <= KINDS_OF_LAW and set(right["course"]) <= COURSES


@pytest.mark.parametrize("causes", [NINTH, TENTH, ELEVENTH])
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
    everywhere = {"warm_magnets", "hanging_tether", "railway_feeder", "wetted_metals"}
    assert beside == single - everywhere - {"magnet_pump", "dropped_weight", "neighbouring_lift"}


def test_a_shackle_swings_after_each_knock(change_of):
    """It swings at one frequency, and twice that, and each knock makes it swing more than just before."""
    scene, _, change = change_of("swinging_shackle", 1, samples=1000)
    values = np.linalg.svd(change - change.mean(axis=0), full_matrices=False)[0][:, 0]
    power = np.abs(np.fft.rfft(values)) ** 2
    peak = power.argmax()
    assert power[peak - 20 : peak + 21].sum() > 0.8 * power.sum() and 0.03 < peak / scene.sample_count < 0.31
    loud = np.abs(change).max(axis=1).reshape(-1, 50).max(axis=1)
    assert (np.diff(loud) > 0).any() and loud.min() < 0.5 * loud.max()


def test_magnets_weaken_by_the_heat_of_the_current(draw):
    """All sensors have one course, each along a direction of its own, and it goes with the square of the current."""
    scene = draw(1)
    vectors, scalar = NINTH["warm_magnets"].draw(np.random.default_rng(1), scene).change(1.0, ())
    flat = vectors.reshape(scene.sample_count, -1)
    assert np.linalg.matrix_rank(flat, 1e-6 * np.linalg.norm(flat)) == 1 and scalar.any()
    course = flat[:, np.abs(flat).max(axis=0).argmax()]
    assert abs(np.corrcoef(course, scene.current(scene.time_s) ** 2)[0, 1]) > 0.3
    assert np.abs(np.diff(course)).max() < 0.5 * np.ptp(course)


def test_a_laser_hops_with_its_warmth(draw):
    """There are a few levels, and each belongs to one range of temperatures."""
    scene = draw(2)
    cause = NINTH["hopping_laser"].draw(np.random.default_rng(2), scene)
    vectors, scalar = cause.change(1.0, ())
    levels, level = np.unique(np.round(scalar, 15), return_inverse=True)
    assert 2 <= len(levels) <= cause.parameters["hops"] + 1 and not vectors.any()
    air_C = scene.temperature(scene.time_s)
    within = sum(air_C[level == one].var() * np.mean(level == one) for one in range(len(levels)))
    assert within < 0.6 * air_C.var()


def test_a_loose_crimp_takes_the_same_part_of_all_it_feeds(draw):
    """By something else each time, and nothing between."""
    scene = draw(1)
    cause = NINTH["loose_crimp"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1.0, ())
    fed = [sensor - 1 for sensor in cause.sensors]
    part = to_nanotesla(-vectors[:, fed] / scene.readings_T[:, fed]) * scene.intensity_T.mean()
    np.testing.assert_allclose(part, np.broadcast_to(part[:, :1, :1], part.shape), atol=1e-9)
    depths = set(np.round(part[:, 0, 0], 9)) - {0.0}
    assert 2 <= len(depths) <= cause.parameters["times"] and 0.05 < (part[:, 0, 0] > 0).mean() < 0.95
    assert not np.delete(vectors, fed, axis=1).any()


def test_a_wet_plug_takes_ever_more(change_of):
    """Of each axis a part of its reading that only grows, and slowly."""
    scene, cause, change = change_of("wet_plug", 1)
    axis = int(np.abs(change).max(axis=0).argmax())
    part = -change[:, axis] / scene.readings_T[:, cause.sensors[0] - 1, axis]
    assert (np.diff(part) > -1e-9 * part.max()).all() and np.diff(part).max() < 0.05 * part.max()


def test_a_filter_is_late_once_it_is_set(draw):
    """Nothing before; then by half of all its time, in all sensors that it serves."""
    scene = draw(2, motions=("diver",))
    cause = NINTH["reset_filter"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-5, ())
    served = [sensor - 1 for sensor in cause.sensors]
    rate = (scene.readings_T - scene.readings_at(scene.time_s - 1e-5))[:, served]
    late = -(vectors[:, served] * rate).sum(axis=2) / (rate**2).sum(axis=2)
    longer = late[:, 0] > 1e-3
    assert np.count_nonzero(np.diff(longer)) in {1, 2} and not longer[: int(0.2 * len(longer))].any()
    np.testing.assert_allclose(late[longer], (cause.parameters["taps"] - 1) / 2, rtol=0.05)
    assert not np.delete(vectors, served, axis=1).any()


def test_a_watch_crystal_only_loses(draw):
    """Its sensors are later and later, all by the same, and faster the farther it is from 25 °C."""
    scene = draw(2, motions=("diver",))
    cause = NINTH["watch_crystal"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-5, ())
    timed = [sensor - 1 for sensor in cause.sensors]
    rate = (scene.readings_at(scene.time_s + 1e-5) - scene.readings_T)[:, timed]
    late = -(vectors[:, timed] * rate).sum(axis=2) / (rate**2).sum(axis=2)
    np.testing.assert_allclose(late, np.repeat(late[:, :1], len(timed), axis=1), atol=0.02)
    off = (scene.temperature(scene.time_s) - 25) ** 2
    assert late[-1, 0] > late[0, 0] and np.corrcoef(np.gradient(late[:, 0]), off)[0, 1] > 0.9


def test_negative_readings_have_their_own_gain(change_of):
    """What is above zero is right; what is below lies on another line."""
    scene, cause, change = change_of("unequal_halves", 2)
    reading = scene.readings_T[:, cause.sensors[0] - 1]
    assert not change[reading >= 0].any()
    axis = int(np.abs(change).max(axis=0).argmax())
    below = reading[:, axis] < 0
    line = np.polyfit(reading[below, axis] / scene.intensity_T.mean(), to_nanotesla(change[below, axis]), 1)
    assert abs(line[0]) == pytest.approx(1) and abs(line[1]) <= 0.3


def test_a_sinker_hangs_below(draw):
    """A level turn leaves it where it is under the array; a tilt moves it, and a tilt back brings it back."""
    scene = draw(1)
    there_and_back = 1 - np.abs(1 - 2 * scene.time_s / scene.duration_s)

    def changed(yaw, pitch):
        def angles(time_s):
            share = np.interp(time_s, scene.time_s, there_and_back)
            return np.outer(share, [yaw, pitch, 0])

        turning = replace(scene, motion=ContinuousMotion("tumbling", angles))
        vectors, _ = NINTH["hanging_tether"].draw(np.random.default_rng(1), turning).change(1e-3, ())
        return vectors

    tilted = changed(0.5, 1.0)
    np.testing.assert_allclose(tilted, tilted[::-1], atol=1e-6 * np.abs(tilted).max())
    assert (np.ptp(tilted, axis=0).max(axis=1) > 0).all()
    level = changed(1.0, 1e-4)
    assert np.ptp(level, axis=0).max() < 0.1 * np.abs(level).max()


def test_a_sparker_strikes_at_equal_intervals(draw):
    """A few readings, of the same sensors at once, a whole number of intervals apart."""
    scene = draw(1, samples=2000)
    cause = NINTH["seismic_sparker"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    struck = vectors[:, [sensor - 1 for sensor in cause.sensors]].any(axis=2)
    assert (struck == struck[:, :1]).all() and 0.003 < struck.mean() < 0.1 and not scalar.any()
    apart = np.diff(scene.time_s[struck[:, 0]]) / cause.parameters["interval_s"]
    assert np.abs(apart - np.round(apart)).max() < 0.7 / 8


def test_a_faint_resonance_is_noisy(draw):
    """The scalar alone, and in some attitudes much more than in others."""
    scene = draw(2, samples=2000)
    vectors, scalar = NINTH["faint_resonance"].draw(np.random.default_rng(2), scene).change(1.0, ())
    loud = np.sort([part.std() for part in np.array_split(scalar, 100)])
    assert loud[-10] > 2 * loud[10] and not vectors.any()


def test_brushes_spark_under_load(draw):
    """The noise of some sensors goes with the current, and is another in each axis."""
    scene = draw(1, samples=2000)
    cause = NINTH["sparking_brushes"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    reached = [sensor - 1 for sensor in cause.sensors]
    heard, load_A = vectors[:, reached].reshape(scene.sample_count, -1), scene.current(scene.time_s)
    heavy, light = load_A > np.quantile(load_A, 0.7), load_A < np.quantile(load_A, 0.3)
    assert heard[heavy].std() > 1.5 * heard[light].std() and not scalar.any()
    assert np.abs(np.corrcoef(heard.T) - np.eye(heard.shape[1])).max() < 0.2
    assert not np.delete(vectors, reached, axis=1).any()


def test_a_feeder_swings_at_rest_in_the_world(draw):
    """At one attitude all sensors have one tone; at another it is along another line."""
    scene, lines = draw(1, samples=1000), []
    for yaw in (0.0, 2.5):
        still = replace(
            scene, motion=ContinuousMotion("turntable", lambda time_s, yaw=yaw: np.full((len(time_s), 3), yaw))
        )
        vectors, scalar = TENTH["railway_feeder"].draw(np.random.default_rng(1), still).change(1e-3, ())
        values, sizes, rows = np.linalg.svd(vectors.reshape(scene.sample_count, -1), full_matrices=False)
        assert sizes[1] < 1e-6 * sizes[0] and scalar.any()
        power = np.abs(np.fft.rfft(values[:, 0])) ** 2
        peak = power.argmax()
        assert power[peak - 20 : peak + 21].sum() > 0.9 * power.sum() and 0.12 < peak / scene.sample_count < 0.4
        lines.append(rows[0])
    assert abs(lines[0] @ lines[1]) < 0.9


def test_a_shunt_is_magnetised_less_in_the_heat(change_of):
    """By the same part of the field at the same warmth, and the less the warmer."""
    scene, cause, change = change_of("thermal_shunt", 1)
    field, air_C = scene.field_T @ scene.response[cause.sensors[0] - 1].T, scene.temperature(scene.time_s)
    tensors = []
    for part in (air_C < np.quantile(air_C, 0.2), air_C > np.quantile(air_C, 0.8)):
        tensor = np.linalg.lstsq(field[part], change[part], rcond=None)[0]
        tensors.append(np.linalg.norm(tensor))
    assert tensors[0] > 1.3 * tensors[1]


def test_an_oscillator_sticks_to_harmonics(draw):
    """Near one every reading is the same; farther away the readings are pulled there, the less the farther."""
    scene = draw(2, samples=2000)
    cause = TENTH["pulled_oscillator"].draw(np.random.default_rng(2), scene)
    sensor, axis = cause.sensors[0] - 1, "xyz".index(cause.axes[0])
    reading = scene.readings_T[:, sensor, axis]
    half = np.ptp(reading) / 50
    change = cause.change(half, ())[0][:, sensor, axis]
    read = (reading + change)[np.argsort(reading)]
    assert 0.05 < np.mean(np.abs(np.diff(read)) < 1e-9 * half) < 0.6
    assert np.abs(change).max() <= half * (1 + 1e-9) and 0 < np.median(np.abs(change)) < 0.4 * half


def test_seconds_are_lost_in_dives(draw):
    """The scalar alone is off, by the same part of the field in each dive."""
    scene = draw(1)
    cause = TENTH["lost_reference"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    below, part = scalar != 0, scalar / scene.intensity_T
    assert not vectors.any() and 0.05 < below.mean() < 0.95
    np.testing.assert_allclose(part[below], part[below][0])
    assert 1 < np.count_nonzero(np.diff(below)) <= 2 * cause.parameters["dives"]


def test_screens_that_touch_hold_back_the_turning(change_of):
    """While they do, one component of the field's rate goes along one line; nothing else happens."""
    scene, _, change = change_of("touching_screens", 1, motions=("diver",))
    closed = change.any(axis=1)
    assert 0.05 < closed.mean() < 0.95 and np.linalg.matrix_rank(change, 1e-6 * np.linalg.norm(change)) == 1
    rate = (scene.field_at(scene.time_s + 1e-4) - scene.field_at(scene.time_s - 1e-4))[closed]
    left = change[closed] - rate @ np.linalg.lstsq(rate, change[closed], rcond=None)[0]
    assert np.abs(left).max() < 0.01 * np.abs(change).max()


def test_a_radio_is_late_where_it_is_turned_away(draw):
    """By a power of two less one, all that it sends alike, and the same again when it is turned back."""
    scene = draw(1)

    def there_and_back(time_s):
        yaw = 2 * np.pi * (1 - np.abs(1 - 2 * time_s / scene.duration_s))
        return np.stack([yaw, 0 * yaw + 0.3, 0 * yaw + 0.2], axis=1)

    turning = replace(scene, motion=ContinuousMotion("tumbling", there_and_back))
    cause = TENTH["adaptive_radio"].draw(np.random.default_rng(1), turning)
    vectors, _ = cause.change(1e-5, ())
    sent = [sensor - 1 for sensor in cause.sensors]
    rate = (turning.readings_T - turning.readings_at(scene.time_s - 1e-5))[:, sent]
    late = -(vectors[:, sent] * rate).sum(axis=2) / (rate**2).sum(axis=2)
    inside = slice(5, -5)
    halvings = np.log2(late[inside] + 1)
    np.testing.assert_allclose(halvings, np.repeat(np.round(halvings[:, :1]), len(sent), axis=1), atol=0.05)
    assert np.mean(np.round(halvings) != np.round(halvings[::-1])) < 0.05 and np.ptp(np.round(halvings)) >= 1
    assert not np.delete(vectors, sent, axis=1).any()


def test_a_fluid_sinks_late(draw):
    """A level turn moves nothing, so that one matrix of the field is all; a tilt moves it, and not at once."""
    scene = draw(1)

    def tilted_halfway(time_s):
        return np.outer(np.where(time_s > scene.duration_s / 2, 1.2, 0.0), [0, 1, 0]) + np.outer(time_s, [0.5, 0, 0])

    turning = replace(scene, motion=ContinuousMotion("tumbling", tilted_halfway))
    cause = TENTH["ferrofluid_seal"].draw(np.random.default_rng(1), turning)
    change = cause.change(1.0, ())[0][:, cause.sensors[0] - 1]
    left = []
    for part in np.array_split(np.arange(scene.sample_count), 4):
        tensor = np.linalg.lstsq(turning.field_T[part], change[part], rcond=None)[0]
        left.append(np.abs(change[part] - turning.field_T[part] @ tensor).max() / np.abs(change).max())
    assert left[0] < 1e-6 and left[2] > 1e-3 and left[3] < 0.1 * left[2]


def test_a_radar_is_heard_once_a_turn(draw):
    """The same sensors are noisy at the same times, which are equally far apart."""
    scene = draw(1, samples=2000)
    cause = TENTH["sweeping_radar"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    reached = [sensor - 1 for sensor in cause.sensors]
    power = (vectors[:, reached] ** 2).sum(axis=(1, 2))
    turns = scene.time_s / cause.parameters["turn_s"]
    by_phase = [power[np.floor(8 * turns) % 8 == phase].mean() for phase in range(8)]
    assert max(by_phase) > 20 * min(by_phase) and not scalar.any()
    assert not np.delete(vectors, reached, axis=1).any()


def test_lightning_strikes_a_few_readings(draw):
    """Of the scalar, and of nothing else."""
    scene = draw(1, samples=2000)
    vectors, scalar = TENTH["lightning_strokes"].draw(np.random.default_rng(1), scene).change(1.0, ())
    assert 0.001 < (scalar != 0).mean() < 0.06 and not vectors.any()


def test_a_pipe_keeps_what_a_surge_magnetised(change_of):
    """Its field is along one line, follows the current, and is more after a surge than before at the same current."""
    scene, _, change = change_of("steel_pipe", 1)
    values, sizes, _ = np.linalg.svd(change, full_matrices=False)
    load_A = scene.current(scene.time_s)
    assert sizes[1] < 1e-9 * sizes[0] and abs(np.corrcoef(values[:, 0], load_A)[0, 1]) > 0.5
    design = np.column_stack([load_A, np.ones(scene.sample_count)])
    left = values[:, 0] - design @ np.linalg.lstsq(design, values[:, 0], rcond=None)[0]
    assert left.std() > 0.1 * values[:, 0].std()


def test_a_current_between_metals_only_falls(draw):
    """All sensors have one course, slower and slower, each along a direction of its own."""
    scene = draw(1)
    vectors, scalar = TENTH["wetted_metals"].draw(np.random.default_rng(1), scene).change(1.0, ())
    flat = vectors.reshape(scene.sample_count, -1)
    assert np.linalg.matrix_rank(flat, 1e-6 * np.linalg.norm(flat)) == 1 and scalar.any()
    falls = -np.diff(np.abs(flat[:, np.abs(flat).max(axis=0).argmax()]))
    assert (falls > 0).all() and falls[0] > 3 * falls[-1]


def test_a_battery_is_changed(draw):
    """All that it feeds reads the same part more or less, which steps at a change and falls between."""
    scene = draw(1)
    cause = TENTH["changed_battery"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1.0, ())
    fed = [sensor - 1 for sensor in cause.sensors]
    part = to_nanotesla(vectors[:, fed] / scene.readings_T[:, fed]) * scene.intensity_T.mean()
    np.testing.assert_allclose(part, np.broadcast_to(part[:, :1, :1], part.shape), atol=1e-9)
    steps = np.diff(part[:, 0, 0])
    changed = np.abs(steps) > 0.3
    assert changed.sum() == cause.parameters["changes"] and (steps[~changed] <= 1e-12).all()
    assert not np.delete(vectors, fed, axis=1).any()


def test_a_pump_slows_under_load(draw):
    """Its magnets turn in one plane, by a smaller angle from one sample to the next while more is drawn."""
    scene = draw(1, samples=1000)
    vectors, scalar = ELEVENTH["magnet_pump"].draw(np.random.default_rng(1), scene).change(1e-3, ())
    values, sizes, _ = np.linalg.svd(vectors.reshape(scene.sample_count, -1), full_matrices=False)
    assert sizes[2] < 1e-6 * sizes[0] and scalar.any()
    turned = np.abs(np.diff(np.unwrap(np.arctan2(values[:, 1], values[:, 0]))))
    load_A = scene.current(scene.time_s)[1:]
    heavy, light = load_A > np.quantile(load_A, 0.7), load_A < np.quantile(load_A, 0.3)
    assert turned[heavy].mean() < turned[light].mean()


def test_weights_are_gone_once_dropped(draw):
    """Each drop is a step in all sensors, and after the last nothing is left."""
    scene = draw(1)
    cause = ELEVENTH["dropped_weight"].draw(np.random.default_rng(1), scene)
    size = np.linalg.norm(cause.change(1.0, ())[0], axis=2)
    steps = np.abs(np.diff(size, axis=0)) > 0.2 * size.max(axis=0)
    assert (steps.sum(axis=0) == cause.parameters["drops"]).all() and not size[-1].any()


def test_a_lift_stands_at_floors(draw):
    """At one attitude its field has one value at each floor, and is seldom anything else."""
    scene = draw(1, samples=1000)
    still = replace(scene, motion=ContinuousMotion("turntable", lambda time_s: np.full((len(time_s), 3), 0.4)))
    vectors, scalar = ELEVENTH["neighbouring_lift"].draw(np.random.default_rng(1), still).change(1.0, ())
    levels, counts = np.unique(np.round(to_nanotesla(vectors[:, 0, 0]), 9), return_counts=True)
    assert 2 <= np.sum(counts > 10) <= 5 and counts[counts > 10].sum() > 0.85 * scene.sample_count
    assert len(levels) > 2 and scalar.any()


def test_a_camera_is_held_level(draw):
    """A level turn takes it along, so that its field stays as it is; a tilt does not."""
    scene = draw(1)
    spread = []
    for turning in ([3.0, 0, 0], [0, 1.0, 0]):
        motion = ContinuousMotion("tumbling", lambda time_s, by=turning: np.outer(time_s / scene.duration_s, by))
        cause = ELEVENTH["gimballed_camera"].draw(np.random.default_rng(1), replace(scene, motion=motion))
        change = cause.change(1.0, ())[0][:, cause.sensors[0] - 1]
        spread.append(np.ptp(change, axis=0).max() / np.abs(change).max())
    assert spread[0] < 1e-9 and spread[1] > 0.1


def test_neither_transistor_conducts_at_the_crossing(draw):
    """There all readings are one; on both sides they are off by half the gap, towards each other."""
    scene = draw(2, samples=2000)
    cause = ELEVENTH["crossover_distortion"].draw(np.random.default_rng(2), scene)
    sensor, half = cause.sensors[0] - 1, 1e-6
    change = cause.change(half, ())[0][:, sensor]
    axis = int(np.abs(change).max(axis=0).argmax())
    order = np.argsort(scene.readings_T[:, sensor, axis])
    error = change[order, axis]
    assert (np.diff(error) <= 1e-15).all() and error[0] == half and error[-1] == -half
    read = scene.readings_T[order, sensor, axis] + error
    inside = np.abs(error) < half
    assert inside.any() and np.ptp(read[inside]) < 1e-6 * half


def test_a_supply_sags_under_load(draw):
    """All that it feeds reads the same part less, and the more current the less."""
    scene = draw(1)
    cause = ELEVENTH["sagging_supply"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1.0, ())
    fed = [sensor - 1 for sensor in cause.sensors]
    part = to_nanotesla(-vectors[:, fed] / scene.readings_T[:, fed]) * scene.intensity_T.mean()
    np.testing.assert_allclose(part, np.broadcast_to(part[:, :1, :1], part.shape), atol=1e-9)
    assert np.corrcoef(part[:, 0, 0], scene.current(scene.time_s))[0, 1] > 0.9
    assert not np.delete(vectors, fed, axis=1).any()


def test_a_mount_creeps_ever_slower(change_of):
    """The reading turns about one line, by an angle that grows with the logarithm of time."""
    scene, cause, change = change_of("creeping_mount", 1)
    core = scene.core(cause.sensors[0] - 1)
    np.testing.assert_allclose((change * core).sum(axis=1), 0, atol=1e-9 * np.abs(change).max())
    values = np.linalg.svd(change, full_matrices=False)
    line = values[2][2]
    angle = np.linalg.norm(change, axis=1) / np.linalg.norm(np.cross(line, core), axis=1)
    grown = np.diff(angle)
    assert values[1][2] < 1e-9 * values[1][0] and (grown > 0).all() and grown[0] > 1.2 * grown[-1]


def test_a_queue_fills_and_empties(draw):
    """All that waits in it is late alike, at once after a stall, then less and less; between it is on time."""
    scene = draw(2, motions=("diver",))
    cause = ELEVENTH["stalled_queue"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-5, ())
    queued = [sensor - 1 for sensor in cause.sensors]
    rate = (scene.readings_T - scene.readings_at(scene.time_s - 1e-5))[:, queued]
    late = -(vectors[:, queued] * rate).sum(axis=2) / (rate**2).sum(axis=2)
    np.testing.assert_allclose(late, np.repeat(late[:, :1], len(queued), axis=1), atol=0.02)
    rises = np.diff(late[:, 0]) > 0.1
    assert 1 <= rises.sum() <= cause.parameters["stalls"] and 0.1 < np.mean(late[:, 0] < 1e-6) < 0.95
    assert not np.delete(vectors, queued, axis=1).any()


def test_an_integrator_falls_behind_fast_turns(change_of):
    """Against the rate of its axis, and only where that is fast."""
    scene, cause, change = change_of("slewing_integrator", 1, motions=("diver",))
    sensor, axis = cause.sensors[0] - 1, "xyz".index(cause.axes[0])
    rate = (scene.readings_at(scene.time_s + 1e-4) - scene.readings_at(scene.time_s - 1e-4))[:, sensor, axis]
    behind = change[:, axis] != 0
    assert (change[:, axis] * rate <= 0).all() and 0.1 < behind.mean() < 0.7
    assert np.abs(rate[behind]).min() > 0.99 * np.abs(rate[~behind]).max()


def test_protons_fade_as_a_battery_drains(draw):
    """The scalar alone is noisy, and at the end much more than at the start."""
    scene = draw(1, samples=2000)
    vectors, scalar = ELEVENTH["draining_polariser"].draw(np.random.default_rng(1), scene).change(1.0, ())
    assert scalar[-200:].std() > 1.8 * scalar[:200].std() and not vectors.any()


def test_leads_are_seen_in_the_cold(draw):
    """One component of the field's direction, times a line in the temperature."""
    scene = draw(2)
    vectors, scalar = ELEVENTH["heater_leads"].draw(np.random.default_rng(2), scene).change(1.0, ())
    unit, air_C = scene.field_T / scene.intensity_T[:, None], scene.temperature(scene.time_s)
    design = np.column_stack([unit, unit * air_C[:, None]])
    left = scalar - design @ np.linalg.lstsq(design, scalar, rcond=None)[0]
    assert np.abs(left).max() < 1e-9 * np.abs(scalar).max() and not vectors.any()
    cold, warm = air_C < np.quantile(air_C, 0.25), air_C > np.quantile(air_C, 0.75)
    assert scalar[cold].std() > scalar[warm].std()


def test_a_surge_strikes_where_a_load_is_switched_on(draw):
    """One reading each, of the same sensors, at which the current has grown."""
    scene = draw(1, samples=1000)
    cause = ELEVENTH["inrush_surge"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    near = [sensor - 1 for sensor in cause.sensors]
    struck = vectors[:, near].any(axis=2)
    assert (struck == struck[:, :1]).all() and 2 <= struck[:, 0].sum() < 30 and not scalar.any()
    rows = np.flatnonzero(struck[:, 0])
    assert (np.diff(scene.current(scene.time_s), prepend=0)[rows] > 0).all() and np.diff(rows).min() > 1
