"""The live calibration: what it tells of changes, what it does then, and when it publishes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from live_mission import UNCHANGING, ashore, dive, moved, rates_of_dive
from numpy.linalg import inv, norm
from numpy.testing import assert_array_equal
from scipy.signal import lfilter
from scipy.special import chdtrc

from tam_calibration.fit.contradiction import FAR_RATIO
from tam_calibration.live.change import CLEAR_RATIO, hypotheses
from tam_calibration.live.change_window import (
    BLOCK_S,
    DECIDE_S,
    FALSE_ALARMS_A_DAY,
    FEWEST_AFTER,
    SCREENED,
    WINDOW,
    chance_of_test,
)
from tam_calibration.live.live import MOST_CHANGES, PUBLISHED_FROM, WIDENED, Live
from tam_calibration.live.recursion import LARGEST_WALK, Belief, Recursion
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import DAY_S, ChangeRates, Gyroscope
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees

CHANGE_S = 21.0

NOISE_KNOWN_S = 80.0
"""Stamp from which the noise over a quarter of a minute is known."""


@pytest.fixture(scope="module")
def prior(true_errors, cross):
    """Return the calibration of the pier, a day old."""
    return ashore(true_errors, cross, np.random.default_rng(10))


def run(prior, errors, after, cross, on_change="tell", until_s=45.0, tilt=np.pi / 18):
    """Return the live calibration after a dive of 20 Hz in which the errors change, and the stamp of the first tale."""
    live, told_s = Live(prior, on_change), None
    rows = [
        dive(each, cross, np.random.default_rng(11), time_s, tilt)
        for each, time_s in ((errors, np.arange(0, CHANGE_S, 0.05)), (after, np.arange(CHANGE_S, until_s, 0.05)))
    ]
    for some in np.array_split(np.concatenate(rows), round(until_s)):
        live.add(some)
        if told_s is None and live.state.changes:
            told_s = some[-1, 0]
    return live, told_s


@pytest.mark.parametrize(
    ("law", "parameters", "change"),
    [
        ("offset", "bias", {"bias_T": np.array([12e-9, 8e-9, 0])}),
        ("gain", "scale factor", {"scale_factor": np.array([5e-4, 0, 0])}),
        ("gain", "misalignment", {"misalignment": np.array([0, 0, 5e-4])}),
    ],
)
def test_a_change_is_named_by_law_sensor_and_parameters(prior, true_errors, cross, law, parameters, change):
    """Within half a minute, by the words of a diagnosis for its law, and nothing is said before it."""
    live, told_s = run(prior, true_errors, moved(true_errors, 3, **change), cross)
    [told] = live.state.changes
    assert told.sensor == 3 and told.parameters[0] == parameters
    assert CHANGE_S < told_s < CHANGE_S + 30 and abs(told.since_s - CHANGE_S) < 2 * BLOCK_S
    assert told.law == law and told.sentence.startswith(f"{law}, in a step: {parameters} of sensor 3 by ")


def test_a_change_is_told_of_sensors_that_have_aged(prior, true_errors, cross):
    """What they have changed in a day is learned, and no noise of the blocks by the calibration of before."""
    aged = true_errors.to_vector() + np.random.default_rng(8).normal(size=(4, 12)) * np.sqrt(
        ChangeRates().variances(DAY_S, 0.0)
    )
    aged[0, 9:] = 0
    errors = SensorErrors.from_vector(aged, true_errors.orientation)
    live, told_s = run(prior, errors, moved(errors, 3, bias_T=np.array([6e-9, 4e-9, 0])), cross)
    [told] = live.state.changes
    assert (told.sensor, told.parameters[0]) == (3, "bias") and told_s < CHANGE_S + 30


@pytest.mark.parametrize(
    ("kind", "change"),
    [
        ("bias", {"bias_T": np.array([-30e-6, 20e-6, 30e-6])}),
        ("scale factor", {"scale_factor": np.array([0.05, -0.02, 0.0])}),
        ("misalignment", {"misalignment": np.array([0.05, 0.08, -0.03])}),
        ("several errors", {"bias_T": np.array([2e-6, 1e-6, 0.0]), "scale_factor": np.array([0.01, 0.0, 0.0])}),
    ],
)
def test_a_change_as_large_as_the_field_is_told_and_learned(prior, true_errors, cross, kind, change):
    """A magnet on a tool, an amplifier that broke: lengths bend over it, and it passes for no other change."""
    after = moved(true_errors, 3, **change)
    live, told_s = run(prior, true_errors, after, cross, on_change="learn")
    [told] = live.state.changes
    assert (told.sensor, told.parameters) == (3, (kind,)) and told_s < CHANGE_S + 30
    now = live.state.recursion.now
    free = np.diag(now.covariance) > 0
    off = (now.errors.to_vector() - after.to_vector()).ravel()[free]
    assert np.abs(off / np.sqrt(np.diag(now.covariance))[free]).max() < 4


def test_noise_that_lasts_is_no_change_at_sea(prior, true_errors, cross):
    """3 nT that last for a second, 360 times what white noise does to a sum: their blocks show it."""
    kept, generator = np.exp(-1 / 20), np.random.default_rng(21)
    time_s = np.arange(0, 60, 0.05)
    white = generator.normal(size=(len(time_s), 12))
    rows = dive(true_errors, cross, generator, time_s)
    rows[:, 1:13] += 3e-9 * lfilter([np.sqrt(1 - kept**2)], [1, -kept], white, axis=0)
    live = Live(prior, "tell")
    for some in np.array_split(rows, 60):
        live.add(some)
    assert not live.state.changes


def learned_beside(prior, rows, factor):
    """Return the live calibration after rows, by a stored one whose common mode had a variance factor."""
    slow = {"slow_common_mode": factor}
    wide = replace(prior, covariance=1e4 * prior.covariance)
    live = Live(replace(wide, calibration=replace(prior.calibration, reduced_chi_square=slow)), "tell")
    for some in np.array_split(rows, 60):
        live.add(some)
    return live


def test_a_scalar_that_was_slow_ashore_counts_less_at_sea(prior, true_errors, cross):
    """By a factor of 4 the field of a bias is twice as uncertain; between sensors it is as certain."""
    rows = dive(true_errors, cross, np.random.default_rng(23), np.arange(0, 60, 0.05))
    beliefs = [learned_beside(prior, rows, factor).state.recursion.now for factor in (1.0, 4.0)]
    for signs, expected in (([1, 1], 2), ([1, -1], 1)):
        weight = np.zeros((4, 12))
        weight[:2, 6:9] = np.array(signs)[:, None] * inv(true_errors.matrix[:2])[:, 0]
        white, slow = (weight.ravel() @ belief.covariance @ weight.ravel() for belief in beliefs)
        assert np.sqrt(slow / white) == pytest.approx(expected, rel=0.1)


def test_intensities_that_lasted_ashore_are_no_change_at_sea(prior, true_errors, cross):
    """10 nT that last for half a second, which the stored calibration knows of or not: their blocks show it."""
    kept, generator = np.exp(-1 / 10), np.random.default_rng(22)
    rows = dive(true_errors, cross, generator, np.arange(0, 60, 0.05))
    rows[:, 13] += 10e-9 * lfilter([np.sqrt(1 - kept**2)], [1, -kept], generator.normal(size=len(rows)))
    for factor in (1.0, 1e4):
        live = learned_beside(prior, rows, factor)
        assert not live.state.changes and live.state.recursion.now.distance(true_errors) < 1.3


def test_what_the_rates_allow_is_no_change(true_errors, cross):
    """A step that is told elsewhere is none of sensors whose bias walks so far each second."""
    rates = replace(UNCHANGING, bias_per_day=20e-9 * np.sqrt(86_400.0))
    prior = ashore(true_errors, cross, np.random.default_rng(19), rates)
    live, _ = run(prior, true_errors, moved(true_errors, 3, bias_T=np.array([12e-9, 8e-9, 0])), cross)
    assert live.state.changes == ()


def test_what_the_motion_cannot_tell_apart_is_told_as_such(prior, true_errors, cross):
    """In a vehicle that hardly pitches a scale factor along z is told beside the bias that it looks like."""
    live, told_s = run(prior, true_errors, moved(true_errors, 3, scale_factor=np.array([0, 0, 1e-4])), cross, tilt=0.01)
    [told] = live.state.changes
    assert set(told.parameters) == {"bias", "scale factor"} and told.sensor == 3
    assert f"in a step: {told.parameters[0]} of sensor 3 by " in told.sentence
    assert "which the motion cannot tell apart" in told.sentence
    assert DECIDE_S < told_s - told.since_s < 30


def test_tell_leaves_the_calibration_and_restore_brings_the_stored_one_back(prior, true_errors, cross):
    """Neither learns from samples after the change."""
    after = moved(true_errors, 2, bias_T=np.array([5e-9, 0, 0]))
    told, _ = run(prior, true_errors, after, cross, "tell")
    restored, _ = run(prior, true_errors, after, cross, "restore")
    for live in (told, restored):
        assert live.state.paused_by == "sensors" and live.sentence.startswith("not updated any more")
        assert live.state.recursion.now.distance(true_errors) < 2
    assert np.array_equal(restored.state.recursion.now.errors.to_vector(), prior.errors.to_vector())
    assert np.array_equal(restored.news().errors.to_vector(), prior.errors.to_vector())
    assert restored.news() is None and told.news() is None
    assert not np.array_equal(told.state.recursion.now.errors.to_vector(), prior.errors.to_vector())


def test_nothing_is_published_before_slow_noise_can_be_seen(prior, true_errors, cross):
    """A bias of 20 nT is learned within half a minute, and published once blocks a quarter of a minute apart agree."""
    after = moved(true_errors, 2, bias_T=np.array([20e-9, 0, 0]))
    live, _ = run(prior, true_errors, after, cross, "learn", until_s=NOISE_KNOWN_S)
    assert live.state.recursion.now.distance(after) < 2 and live.news() is None


def test_learn_finds_the_new_errors_and_publishes_them(prior, true_errors, cross):
    """They lie within their new standard errors; what has not changed is as certain as before."""
    after = moved(true_errors, 2, bias_T=np.array([20e-9, 0, 0]))
    live, _ = run(prior, true_errors, after, cross, "learn", until_s=NOISE_KNOWN_S + 20)
    calibration = live.news()
    deviation = (calibration.errors.to_vector() - after.to_vector()) / calibration.standard_errors.clip(1e-15)
    deviation[0, 9:] = 0
    assert np.abs(deviation).max() < 4
    assert not live.state.paused_by and live.news() is None
    assert calibration.samples > prior.calibration.samples
    assert "updated with" in calibration.warnings[-1]


def test_a_source_nearby_is_no_change_of_a_sensor_and_learning_goes_on_after_it(prior, true_errors, cross):
    """The gradient is told, nothing is learned while it lasts, and half a minute later it is forgotten."""
    live = Live(prior, "learn")
    time_s = np.arange(0, 120, 0.05)
    rows = dive(true_errors, cross, np.random.default_rng(12), time_s)
    near = (time_s > 31) & (time_s < 45)
    # A gradient of 20 nT/m along x and y: sensors 1 and 3 read it along y, 2 and 4 along x.
    for sensor, axis, place in ((0, 1, 0.25), (2, 1, -0.25), (1, 0, 0.25), (3, 0, -0.25)):
        rows[near, 1 + 3 * sensor + axis] += 20e-9 * place
    live.add(rows[time_s < 60])
    [told] = live.state.changes
    assert told.parameters == ("gradient of the field",) and live.state.paused_by == "field"
    learned = live.state.learned
    live.add(rows[time_s >= 60])
    assert not live.state.paused_by and live.state.learned > learned
    assert live.state.recursion.now.distance(true_errors) < 2


@pytest.mark.parametrize(("moment_A_m2", "distance_m"), [(161.0, 4.0), (1000.0, 6.0), (1000.0, 10.0)])
def test_a_source_that_is_passed_is_neither_learned_nor_told(prior, true_errors, cross, moment_A_m2, distance_m):
    """Neither is a sensor blamed, nor does anything go out that is worse than what is stored."""
    live, generator = Live(prior, "learn"), np.random.default_rng(15)
    time_s = np.arange(0, 180, 0.05)
    rows = dive(true_errors, cross, generator, time_s)
    path_m = np.stack([1.5 * (time_s - 90), np.full(len(time_s), distance_m), np.zeros(len(time_s))], axis=1)
    moment, places_m = moment_A_m2 * np.array([0.6, -0.48, 0.64]), np.vstack([cross.positions_m, np.zeros(3)])
    offset_m = path_m[:, None] + places_m
    size_m = norm(offset_m, axis=2, keepdims=True)
    unit = offset_m / size_m
    source_T = 1e-7 * (3 * unit * (unit @ moment)[..., None] - moment) / size_m**3
    fields_T = true_errors.restore(rows[:, 1:13].reshape(-1, 4, 3)) + source_T[:, :4]
    middle_T = true_errors.restore(rows[:, 1:13].reshape(-1, 4, 3)).mean(axis=1)
    rows[:, 1:13] = (
        np.array([true_errors.matrix[k] @ fields_T[:, k].T for k in range(4)]).transpose(2, 0, 1).reshape(-1, 12)
    )
    rows[:, 1:13] += true_errors.bias_T.ravel()
    rows[:, 13] += norm(middle_T + source_T[:, 4], axis=1) - norm(middle_T, axis=1)
    for some in np.array_split(rows, 240):
        live.add(some)
        news = live.news()
        if news is not None:
            off = (news.errors.to_vector() - true_errors.to_vector()) / news.standard_errors.clip(1e-15)
            assert np.abs(off[news.standard_errors > 0]).max() < 6
    assert not [each for each in live.state.changes if each.sensor]


def test_what_predicts_worse_is_not_published(prior, true_errors, cross):
    """What is known is tried on the blocks after it, and given up where the sensors agree less by it."""
    live = Live(prior, "tell")
    wrong = moved(true_errors, 2, bias_T=np.array([30e-9, 0, 0]))
    live.state = replace(live.state, recursion=Recursion.at(Belief(wrong, prior.covariance / 100, np.nan, np.nan)))
    rows = dive(true_errors, cross, np.random.default_rng(16), np.arange(0, 8, 0.05))
    for some in np.array_split(rows, 8):
        live.add(some)
        assert live.news() is None


def test_nothing_is_published_where_nothing_has_changed(true_errors, cross):
    """A vehicle whose calibration leaves no more to learn publishes nothing, and its estimate hardly moves."""
    prior = ashore(true_errors, cross, np.random.default_rng(13), UNCHANGING)
    live, _ = run(prior, true_errors, true_errors, cross, "learn", until_s=45.0)
    assert live.news() is None and live.state.changes == ()
    assert live.calibration.errors is prior.errors


def test_a_state_goes_on_as_if_it_had_not_been_left(prior, true_errors, cross):
    """Two halves by two objects are the whole by one, but for the block at which they part."""
    rows = dive(true_errors, cross, np.random.default_rng(14), np.arange(0, 40, 0.05))
    whole, first = Live(prior, "tell"), Live(prior, "tell")
    whole.add(rows)
    first.add(rows[:401])
    second = Live(prior, "tell", first.state)
    second.add(rows[400:])
    assert second.state.learned == whole.state.learned
    assert whole.state.recursion.now.distance(second.state.recursion.now.errors) < 1e-6


def test_a_calibration_of_arbitrary_scale_is_refused(prior):
    """One sentence says why and what would mend it."""
    relative = replace(prior, calibration=replace(prior.calibration, has_scalar_reference=False))
    with pytest.raises(InputError, match=r"without a scalar magnetometer.*calibrate with one"):
        Live(relative, "tell")


def test_stamps_that_step_back_begin_another_block(prior, true_errors, cross):
    """A recording that is played twice is learned twice, and is no change."""
    rows = dive(true_errors, cross, np.random.default_rng(15), np.arange(0, 10, 0.05))
    live = Live(prior, "tell")
    live.add(np.concatenate([rows, rows]))
    assert live.state.learned > len(rows) and live.state.changes == ()


def test_a_block_has_as_many_degrees_of_freedom_as_its_readings_leave(prior, true_errors, cross):
    """Nine differences of a sample, its intensity where it is known, less 45 errors; too few samples tell nothing."""
    rows = dive(true_errors, cross, np.random.default_rng(16), np.arange(3 * 32 + 1) / 16)
    rows[::2, -2] = np.nan
    live = Live(prior, "tell")
    live.add(rows)
    assert live.state.learned == 3 * 32 and live.state.freedom == 3 * (32 * 9 + 16 - 45)
    few = Live(prior, "tell")
    few.add(rows[::8])
    assert few.state.learned == 3 * 4 and (few.state.freedom, few.state.excess) == (0.0, 1.0)


def test_the_temperature_of_a_block_is_the_mean_of_those_that_are_known(prior, true_errors, cross):
    """Of samples without intensity here: each channel is known where it is."""
    rows = dive(true_errors, cross, np.random.default_rng(17), np.arange(33) / 16)
    rows[::2, -2] = np.nan
    rows[::2, -1] = np.linspace(10, 14, 17)
    live = Live(prior, "tell")
    live.add(rows)
    assert live.state.recursion.now.temperature_C == pytest.approx(rows[:32:2, -1].mean())


def test_what_it_does_is_said(prior, true_errors, cross):
    """How much is learned, and while a change is looked into, which it may be."""
    live = Live(prior, "tell")
    after = moved(true_errors, 2, bias_T=np.array([20e-9, 0, 0]))
    for each, time_s in ((true_errors, np.arange(0, 20, 0.05)), (after, np.arange(20, 40, 0.05))):
        rows = dive(each, cross, np.random.default_rng(18), time_s)
        while len(rows) and not live.is_suspicious:
            assert live.sentence == f"updated with {live.state.learned} samples"
            live.add(rows[:1])
            rows = rows[1:]
    assert live.is_suspicious and rows[0, 0] < 30
    assert re.fullmatch(r"updated with \d+ samples; a change is looked into: .*bias of sensor 2.*", live.sentence)


def test_the_threshold_follows_from_the_alarms_that_are_allowed(true_errors, cross):
    """The chance of a test times all tests of a day is the stated number; 23 things may change in four sensors."""
    count = len(hypotheses(true_errors, cross))
    assert count == 23
    assert chance_of_test(count) * 86_400 / BLOCK_S * WINDOW * count == pytest.approx(FALSE_ALARMS_A_DAY)
    assert chdtrc(3, 41) < chance_of_test(count) < chdtrc(3, 39)


def test_constants():
    """What a reader of docs/how_to/live.md relies on."""
    assert (BLOCK_S, WINDOW, DECIDE_S, FEWEST_AFTER, FALSE_ALARMS_A_DAY) == (2.0, 15, 20.0, 2, 0.1)
    assert SCREENED == (1, 2, 4, 8, 14)
    assert (PUBLISHED_FROM, WIDENED, MOST_CHANGES, LARGEST_WALK) == (0.5, 3.0, 100, 0.1)
    assert pytest.approx(2 * np.log(100)) == CLEAR_RATIO
    assert FAR_RATIO == 1e5


def test_a_calibration_that_leaves_errors_open_is_refused(prior):
    """One whose errors are ten thousand times less certain: over these lengths are no straight lines."""

    def less_certain(times):
        return replace(prior.calibration, covariance=times**2 * prior.calibration.covariance)

    Live(replace(prior, calibration=less_certain(100)), "tell")
    with pytest.raises(InputError, match=r"does not determine .*scale factor x.*, and cannot be kept up to date"):
        Live(replace(prior, calibration=less_certain(10_000)), "tell")


def test_what_is_no_field_is_left_out(prior, true_errors, cross):
    """Drivers send zeros, or another unit, for five seconds: the update is that of the other samples, and says so."""
    rows = dive(true_errors, cross, np.random.default_rng(31), np.arange(0, 20, 0.05))
    is_spoilt = (np.arange(400) >= 100) & (np.arange(400) < 200)
    alone = Live(prior, "learn")
    alone.add(rows[~is_spoilt])
    for factor in (0, 1e9, -1e3):
        live, spoilt = Live(prior, "learn"), rows.copy()
        spoilt[is_spoilt, 1:13] *= factor
        live.add(spoilt)
        assert live.state.learned == alone.state.learned and not live.state.changes
        found, expected = (each.state.recursion.now.errors.to_vector() for each in (live, alone))
        assert_array_equal(found, expected)
        assert live.sentence.endswith("; 100 samples with no field of 15 to 100 µT are left out")


def test_a_scalar_that_reads_no_field_is_none(prior, true_errors, cross):
    """Zeros of a scalar that lost its lock are as no reading."""
    rows = dive(true_errors, cross, np.random.default_rng(32), np.arange(0, 20, 0.05))
    zeros, none = Live(prior, "tell"), Live(prior, "tell")
    rows[100:200, -2] = 0
    zeros.add(rows)
    rows[100:200, -2] = np.nan
    none.add(rows)
    assert_array_equal(zeros.state.recursion.now.errors.to_vector(), none.state.recursion.now.errors.to_vector())
    assert not zeros.state.changes and zeros.state.learned > 300


def test_a_gyroscope_tells_the_vertical_bias_that_a_narrow_turn_does_not(true_errors, cross):
    """Of one sensor whose scale is not known to a per mille, at ±5°; one in the mirror tells nothing."""
    generator, gyroscope = np.random.default_rng(31), Gyroscope(from_degrees(4e-3), from_degrees(0.1))
    array = replace(Array(cross.positions_m[:1], 1e-9, 1e-10), gyroscope=gyroscope)
    spread = np.repeat([1e-3, 3e-4, 50e-9, 0], 3)
    prior = ashore(SensorErrors.from_vector(true_errors.to_vector()[:1]), array, generator)
    prior = prior.with_more(np.diag(spread**2))
    truth = SensorErrors.from_vector(prior.errors.to_vector() + spread * generator.normal(size=(1, 12)))
    time_s, tilt = np.arange(0, 130, 0.05), from_degrees(5.0)
    rows, rates = dive(truth, array, generator, time_s, tilt), rates_of_dive(gyroscope, generator, time_s, tilt)
    found = []
    for each in (None, rates, rates * [1, -1, 1]):
        live = Live(prior, "tell")
        live.add(rows, each)
        assert not live.state.changes
        found.append(live.state.recursion.now)
    alone, beside, mirrored = (np.sqrt(each.covariance[8, 8]) for each in found)
    assert beside < alone / 4 and mirrored == alone
    away = (found[1].errors.to_vector() - truth.to_vector()).ravel()[:9]
    assert np.abs(away / np.sqrt(np.diag(found[1].covariance)[:9])).max() < 3.5
