"""The seventh, the eighth and the ninth set of causes outside the library."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.model.units import to_nanotesla
from tam_validation.blind import SETS
from tam_validation.blind.case_plan import plan_cases
from tam_validation.blind.catalogue import CATALOGUE, CAUSES, LAWS, OUTSIDE_SETS
from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.outside_eighth import EIGHTH
from tam_validation.blind.outside_ninth import NINTH
from tam_validation.blind.outside_seventh import SEVENTH

COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}
KINDS_OF_LAW = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}


def test_the_sets_share_no_name():
    """Neither with each other nor with the library."""
    names = [name for one in (CATALOGUE, *OUTSIDE_SETS.values()) for name in one]
    assert tuple(OUTSIDE_SETS) == SETS and len(names) == len(set(names)) == len(CAUSES)


@pytest.mark.parametrize("name", [*SEVENTH, *EIGHTH, *NINTH])
def test_every_cause_has_a_law_and_a_course(name):
    """Of those that there are."""
    right = LAWS[name]
    assert right["law"] and right["course"]
    assert set(right["law"]) <= KINDS_OF_LAW and set(right["course"]) <= COURSES


@pytest.mark.parametrize("causes", [SEVENTH, EIGHTH, NINTH])
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
    everywhere = {"coiled_cable", "thrusters", "warm_magnets", "hanging_tether"}
    assert beside == single - everywhere - {"winch_drum", "scanning_multiplexer", "passing_boat"}


def test_a_drum_stops_at_any_angle(draw):
    """Its field changes while it turns, by sensors unlike, and stays as it is between the runs."""
    scene = draw(1)
    vectors, scalar = SEVENTH["winch_drum"].draw(np.random.default_rng(1), scene).change(1.0, ())
    size = np.ptp(vectors, axis=0).max()
    still = np.abs(np.diff(vectors, axis=0)).max(axis=(1, 2)) < 1e-9 * size
    assert 0.1 < still.mean() < 0.9 and scalar.any()
    assert np.abs(vectors - vectors.mean(axis=1, keepdims=True)).max() > 0.1 * size


def test_two_fluxgates_hear_one_beat(draw):
    """Each has a line of its own, along which the same tone goes."""
    scene = draw(1)
    cause = SEVENTH["beating_excitations"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    strongest = []
    for sensor in cause.sensors:
        values, _, rows = np.linalg.svd(vectors[:, sensor - 1], full_matrices=False)
        assert rows.shape == (3, 3)
        strongest.append(np.abs(np.fft.rfft(values[:, 0])).argmax())
    assert len(cause.sensors) == 2 and abs(strongest[0] - strongest[1]) <= 1 and not scalar.any()


def test_a_cell_is_noisier_in_the_cold(draw):
    """Noise of the scalar alone, which is larger the colder the air has been."""
    scene = draw(2, samples=4000)
    vectors, scalar = SEVENTH["cold_cell"].draw(np.random.default_rng(2), scene).change(1.0, ())
    air_C = scene.temperature(scene.time_s)
    cold, warm = air_C < np.quantile(air_C, 0.25), air_C > np.quantile(air_C, 0.75)
    assert scalar[cold].std() > 1.5 * scalar[warm].std() and not vectors.any()


def test_cells_are_magnetised_by_the_charge(change_of):
    """By so much of the field as the current that has flowed says, and no more than the field at any time."""
    scene, _, change = change_of("charged_cells", 1)
    course = np.cumsum(scene.current(scene.time_s))
    course = (course - course.mean()) / course.std()
    design = (course[:, None, None] * scene.field_T[:, None]).reshape(scene.sample_count, 3)
    left = change - design @ np.linalg.lstsq(design, change, rcond=None)[0]
    assert left.std() < 0.02 * change.std()


def test_a_worn_ring_takes_the_same_part_of_all_it_feeds(draw):
    """And the same part again when the array is turned back."""
    scene = draw(1)

    def there_and_back(time_s):
        yaw = 2 * np.pi * (1 - np.abs(1 - 2 * time_s / scene.duration_s))
        return np.stack([yaw, 0 * yaw + 0.3, 0 * yaw + 0.2], axis=1)

    turning = replace(scene, motion=ContinuousMotion("tumbling", there_and_back))
    cause = SEVENTH["worn_slip_ring"].draw(np.random.default_rng(1), turning)
    vectors, _ = cause.change(1.0, ())
    fed = [sensor - 1 for sensor in cause.sensors]
    part = vectors[:, fed] / turning.readings_T[:, fed]
    np.testing.assert_allclose(part, np.broadcast_to(part[:, :1, :1], part.shape), atol=1e-9 * np.abs(part).max())
    np.testing.assert_allclose(part, part[::-1], atol=1e-6 * np.abs(part).max())
    assert (part <= 0).all() and not np.delete(vectors, fed, axis=1).any()


def test_a_scan_reads_each_axis_at_a_time_of_its_own(draw):
    """Equal times after one another, sensor by sensor."""
    scene = draw(2, motions=("diver",))
    vectors, _ = SEVENTH["scanning_multiplexer"].draw(np.random.default_rng(2), scene).change(1e-5, ())
    rate = (scene.readings_at(scene.time_s + 1e-5) - scene.readings_at(scene.time_s - 1e-5)) / 2e-5
    late = (vectors * rate).sum(axis=0) / (rate**2).sum(axis=0)
    apart = np.diff(np.sort(late.ravel()))
    np.testing.assert_allclose(apart, 1e-5, rtol=0.05)
    assert (np.diff(late, axis=0) > 0).all()


def test_a_warm_oscillator_is_late_by_its_warmth(draw):
    """Late when it is warm, early when it is cold, or the other way around."""
    scene = draw(2, motions=("diver",))
    cause = SEVENTH["warm_oscillator"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-5, ())
    sensor = cause.sensors[0] - 1
    rate = (scene.readings_at(scene.time_s + 1e-5) - scene.readings_T)[:, sensor] / 1e-5
    late = (vectors[:, sensor] * rate).sum(axis=1) / (rate**2).sum(axis=1)
    assert abs(np.corrcoef(late, scene.temperature(scene.time_s))[0, 1]) > 0.8


def test_a_wrong_bit_spoils_every_other_step(change_of):
    """The error has one size wherever the bit is set, and depends on nothing but the reading."""
    scene, cause, change = change_of("wrong_bit_weight", 2)
    axis = "xyz".index(cause.axes[0])
    error = to_nanotesla(change[:, axis])[np.argsort(scene.readings_T[:, cause.sensors[0] - 1, axis])]
    assert set(np.round(np.abs(error), 9)) == {0.0, 1.0}
    assert 2 < np.count_nonzero(np.diff(error)) < 64


def test_a_short_headroom_flattens_one_end(change_of):
    """Nothing is changed far from that end, nor much without a load."""
    scene, cause, change = change_of("short_headroom", 2)
    axis = int(np.abs(change).max(axis=0).argmax())
    reading, error = scene.readings_T[:, cause.sensors[0] - 1, axis], change[:, axis]
    end = -np.sign(error[np.abs(error).argmax()])
    flattened = error != 0
    assert 0.1 < flattened.mean() < 0.5 and (end * error <= 0).all()
    assert (end * reading[flattened]).min() > (end * reading[~flattened]).max()
    load_A = scene.current(scene.time_s)
    assert (np.abs(error) <= 2.8e-9 * load_A / load_A.max()).all()


def test_a_boat_is_near_now_and_then(draw):
    """Its field is strong for a small part of the time."""
    scene = draw(1, samples=1000)
    vectors, _ = SEVENTH["passing_boat"].draw(np.random.default_rng(1), scene).change(1.0, ())
    size = np.linalg.norm(vectors, axis=2).mean(axis=1)
    assert 0 < (size > size.max() / 2).mean() < 0.3 and np.median(size) < 0.2 * size.max()


def test_a_screen_that_broke_lets_noise_in(change_of):
    """From then on, in all axes."""
    _, _, change = change_of("broken_screen", 1)
    struck = change.any(axis=1)
    assert 0.2 < struck.mean() < 0.8 and np.count_nonzero(np.diff(struck)) == 1 and change[struck].all()


def test_a_flipped_bit_is_a_power_of_two(change_of):
    """In one axis of a few readings; what is worth one more is set to nothing, and the other way around."""
    scene, cause, change = change_of("flipped_bit", 1, amplitude=1e-9, samples=2000)
    struck = change != 0
    assert 0.002 < struck.any(axis=1).mean() < 0.1 and struck.sum(axis=1).max() == 1
    bits = np.log2(np.abs(change[struck]) / 1e-9)
    np.testing.assert_allclose(bits, np.round(bits), atol=1e-9)
    words = np.floor(scene.readings_T[:, cause.sensors[0] - 1][struck] / np.abs(change[struck])) % 2
    assert set(words) == {0, 1} and ((words == 1) == (change[struck] < 0)).all()


def test_a_hot_processor_is_late_by_steps(draw):
    """All sensors that it serves by the same whole numbers of steps, and by more when it is hotter."""
    scene = draw(1, motions=("diver",))
    cause = EIGHTH["throttled_processor"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1e-5, ())
    served = [sensor - 1 for sensor in cause.sensors]
    rate = (scene.readings_T - scene.readings_at(scene.time_s - 1e-5))[:, served]
    steps = -(vectors[:, served] * rate).sum(axis=2) / (rate**2).sum(axis=2)
    np.testing.assert_allclose(steps, np.repeat(np.round(steps[:, :1]), len(served), axis=1), atol=0.02)
    air_C, slow = scene.temperature(scene.time_s), steps[:, 0] > 0.5
    assert 0.05 < slow.mean() < 0.8 and air_C[slow].mean() > air_C[~slow].mean()
    assert not np.delete(vectors, served, axis=1).any()


def test_a_choke_is_magnetised_less_under_load(change_of):
    """The same part of the field at the same current, and most of it without one."""
    scene, cause, change = change_of("biased_choke", 1)
    field, load_A = scene.field_T @ scene.response[cause.sensors[0] - 1].T, scene.current(scene.time_s)
    tensors = []
    for part in (load_A < np.quantile(load_A, 0.3), load_A > np.quantile(load_A, 0.7)):
        tensor = np.linalg.lstsq(field[part], change[part], rcond=None)[0]
        assert np.abs(change[part] - field[part] @ tensor).std() < 0.3 * change[part].std()
        tensors.append(np.linalg.norm(tensor))
    assert tensors[0] > 1.2 * tensors[1]


def _halves(scene):
    late = scene.time_s > scene.duration_s / 2
    return ~late, late


def test_a_coil_on_the_ground_does_not_turn_along(draw):
    """At one attitude its field goes with the current; at another the same current makes another field."""
    scene = draw(1)

    def turned_once(time_s):
        return np.outer(time_s > scene.duration_s / 2, [1.0, 0.5, 0.2])

    turning = replace(scene, motion=ContinuousMotion("turntable", turned_once))
    vectors, scalar = EIGHTH["coiled_cable"].draw(np.random.default_rng(1), turning).change(1.0, ())
    load_A = scene.current(scene.time_s) - scene.current(scene.time_s).min()
    loaded = load_A > load_A.max() / 2
    made = [vectors[loaded & part] / load_A[loaded & part, None, None] for part in _halves(scene)]
    assert all(np.ptp(one, axis=0).max() < 1e-6 * np.abs(one).max() for one in made) and scalar.any()
    assert np.abs(made[0][0] - made[1][0]).max() > 0.1 * np.abs(made[0][0]).max()


def test_thrusters_push_by_the_square_of_the_rate(draw):
    """Twice the rate takes four times the current, the other way around the other sign."""
    scene, slow = draw(1), []
    for rate in (0.1, -0.1):

        def faster_halfway(time_s, rate=rate):
            return np.outer(rate * (time_s + np.maximum(time_s - scene.duration_s / 2, 0)), [1, 0, 0])

        turning = replace(scene, motion=ContinuousMotion("tumbling", faster_halfway))
        vectors, _ = EIGHTH["thrusters"].draw(np.random.default_rng(1), turning).change(1.0, ())
        early, late = (vectors[part][5:-5].mean(axis=0) for part in _halves(scene))
        np.testing.assert_allclose(late, 4 * early, rtol=1e-3)
        slow.append(early)
    np.testing.assert_allclose(slow[0], -slow[1], rtol=1e-3)


def test_a_scalar_takes_the_stronger_of_two_cells(draw):
    """It reads one light shift or the other, and changes between them as it is turned."""
    scene = draw(1)
    vectors, scalar = EIGHTH["paired_cells"].draw(np.random.default_rng(1), scene).change(1.0, ())
    np.testing.assert_allclose(np.abs(scalar), 0.5e-9)
    assert 0.1 < (scalar > 0).mean() < 0.9 and 0 < np.mean(np.diff(scalar) != 0) < 0.5 and not vectors.any()


def test_unequal_signals_err_twice_a_fringe(change_of):
    """The error depends on the reading alone, goes up and down with it several times, and about zero."""
    scene, cause, change = change_of("unequal_quadrature", 2)
    axis = "xyz".index(cause.axes[0])
    error = change[:, axis][np.argsort(scene.readings_T[:, cause.sensors[0] - 1, axis])]
    assert 4 < np.count_nonzero(np.diff(np.sign(error))) < 40
    assert np.abs(np.diff(error)).mean() < 0.3 * np.ptp(error)


def test_a_detector_is_late_one_way_only(draw):
    """It reads what was there before where that was more, else what is there; or the other way around."""
    scene = draw(2)
    cause = EIGHTH["peak_detector"].draw(np.random.default_rng(2), scene)
    vectors, _ = cause.change(1e-4, ())
    sensor = cause.sensors[0] - 1
    before = scene.readings_at(scene.time_s - 1e-4)[:, sensor] - scene.readings_T[:, sensor]
    struck = vectors[:, sensor] != 0
    np.testing.assert_allclose(vectors[:, sensor][struck], before[struck], atol=1e-18)
    for axis in np.flatnonzero(struck.any(axis=0)):
        assert len(set(np.sign(before[struck[:, axis], axis]))) == 1 and 0.2 < struck[:, axis].mean() < 0.8


def test_a_restart_takes_a_matrix_and_offsets_away(change_of):
    """One matrix and one offset while they are gone, nothing before."""
    for seed in range(4):
        scene, cause, change = change_of("lost_settings", seed)
        gone = change.any(axis=1)
        design = np.column_stack([scene.core(cause.sensors[0] - 1), np.ones(scene.sample_count)])[gone]
        left = change[gone] - design @ np.linalg.lstsq(design, change[gone], rcond=None)[0]
        assert np.abs(left).max() < 1e-9 * np.abs(change).max() and not gone[: int(0.2 * len(gone))].any()
        assert np.count_nonzero(np.diff(gone)) in {1, 2}


def test_a_regulator_grows_louder(draw):
    """All sensors that it feeds hear the same noise, each along a direction of its own."""
    scene = draw(1, samples=2000)
    cause = EIGHTH["tired_regulator"].draw(np.random.default_rng(1), scene)
    vectors, _ = cause.change(1.0, ())
    heard = vectors[:, [sensor - 1 for sensor in cause.sensors]].reshape(scene.sample_count, -1)
    parts = [part.std() for part in np.array_split(heard, 3)]
    assert parts[0] < parts[1] < parts[2] and parts[2] > 2 * parts[0]
    assert np.linalg.matrix_rank(heard, 1e-6 * np.linalg.norm(heard)) == 1
    assert not np.delete(vectors, [sensor - 1 for sensor in cause.sensors], axis=1).any()


def test_blades_make_one_tone(draw):
    """While the array rests there is one tone, at twice the rate of the blades."""
    scene = draw(1, samples=1000)
    still = replace(scene, motion=ContinuousMotion("turntable", lambda time_s: np.zeros((len(time_s), 3)) + 0.3))
    cause = EIGHTH["iron_propeller"].draw(np.random.default_rng(1), still)
    vectors, _ = cause.change(1.0, ())
    change = vectors[:, cause.sensors[0] - 1]
    power = (np.abs(np.fft.rfft(change - change.mean(axis=0), axis=0)) ** 2).sum(axis=1)
    peak = power.argmax()
    assert power[peak - 5 : peak + 6].sum() > 0.95 * power.sum() and 0.05 < peak / 1000 < 0.42


def test_a_radio_pushes_while_it_is_keyed(draw):
    """The same sensors each time, by something else in each call, and by nothing between the calls."""
    scene = draw(1)
    cause = EIGHTH["keyed_radio"].draw(np.random.default_rng(1), scene)
    vectors, scalar = cause.change(1.0, ())
    reached = vectors[:, [sensor - 1 for sensor in cause.sensors]]
    keyed = reached.any(axis=2)
    assert (keyed == keyed[:, :1]).all() and 0.1 < keyed.mean() < 0.9 and not scalar.any()
    assert 4 <= len(np.unique(reached[keyed[:, 0]].reshape(keyed[:, 0].sum(), -1), axis=0)) <= cause.parameters["calls"]


def test_what_has_not_settled_lies_between_two_axes(change_of):
    """A few readings hold a part of the axis before, none of them more than all of it."""
    scene, cause, change = change_of("early_interrupt", 1, samples=2000)
    reading = scene.readings_T[:, cause.sensors[0] - 1]
    part = to_nanotesla(change) * scene.intensity_T.mean() / (reading[:, [2, 0, 1]] - reading)
    struck = part > 1e-9
    assert 0 < struck.any(axis=1).mean() < 0.1 and part[struck].min() > 0.29 and part.max() < 1.01


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
