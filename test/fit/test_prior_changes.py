"""What moved is found, told as what it is, and when; what did not move is known from all samples."""

from dataclasses import replace

import numpy as np
import pytest
from moved_sensors import DIRECTION, SIZES, joined, moved, turn

from tam_calibration.correction.parts import KINDS
from tam_calibration.fit import prior_changes
from tam_calibration.fit.contradiction import MOST_CHANGES, candidates_of
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori, with_noise
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import in_first_frame, prior_of
from tam_calibration.fit.prior_changes import update_prior
from tam_calibration.fit.problem import Known
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation import simulate


@pytest.mark.parametrize(("kind", "sensor"), [*zip(KINDS, [0, 2, 2, 0], strict=True)])
def test_a_change_is_told_as_what_it_is(wu_scenario, array, prior, kind, sensor):
    """Kind and sensor, also of the sensor whose frame all others are told in; size within its standard errors."""
    recording = turn(wu_scenario, moved(wu_scenario.errors, kind, sensor), 5)
    resolved = update_prior(recording, array, Known(prior))
    found = resolved.moved[0]
    assert (found.kind, found.sensor) == (kind, sensor + 1)
    assert len(resolved.moved) == 1 and found.since_s is None
    assert found.probability > 0.5
    assert (np.abs(found.change - SIZES[kind] * DIRECTION) < 4.5 * found.standard_errors).all()


@pytest.mark.parametrize(("kind", "times", "first"), [("bias", 1, 570), ("non-orthogonality", 300, 20)])
def test_a_change_within_the_recording_has_a_time(wu_scenario, array, prior, kind, times, first):
    """Also one of 6 µT, beside which no error is a straight line."""
    resolved = update_prior(changed_within(wu_scenario, kind, times, first), array, Known(prior))
    found = resolved.moved[0]
    assert (found.kind, found.sensor, found.since_s) == (kind, 4, resolved.recording.time_s[0])
    assert resolved.recording.sample_count == pytest.approx(600 - first, abs=1)
    assert resolved.earlier[0][0].sample_count + resolved.recording.sample_count == 600


def changed_within(scenario, kind, times, first):
    """Return a turn of 600 samples from one of which on sensor 4 is changed."""
    before, after = (
        turn(scenario, errors, 9, 600) for errors in (scenario.errors, moved(scenario.errors, kind, 3, times))
    )
    return joined(before, after, first)


def test_what_did_not_move_is_known_from_all_samples(wu_scenario, array, prior):
    """Of a bias that moved after nine tenths of a turn: the others are as certain as after the whole turn without."""
    found = fitted(update_prior(changed_within(wu_scenario, "bias", 1, 540), array, Known(prior)), array)
    whole = fitted(update_prior(turn(wu_scenario, wu_scenario.errors, 9, 600), array, Known(prior)), array)
    others = np.s_[1:3]
    assert (found.standard_errors[others] <= 1.02 * whole.standard_errors[others]).all()
    truth = moved(wu_scenario.errors, "bias", 3).to_vector()
    assert (np.abs(found.errors.to_vector() - truth)[1:] < 4.5 * found.standard_errors[1:]).all()


def fitted(resolved, array):
    """Return the calibration beside a prior that is in no contradiction."""
    return maximum_a_posteriori(resolved.recording, array, resolved.known)


@pytest.mark.parametrize("twice", ["main field", "mounting"])
def test_what_lasts_does_not_count_twice(wu_scenario, array, prior, twice):
    """Errors of a main field, and of how attitude is mounted, are those of all samples: the first are left out then."""
    known = Known(prior, np.array([0.0, 2e-5, -4.5e-5]) if twice == "main field" else None)
    resolved = update_prior(
        changed_within(wu_scenario, "bias", 1, 350),
        replace(array, mounting_error=1e-4) if twice == "mounting" else array,
        known,
    )
    assert len(resolved.earlier) == 1 and resolved.known.prior.calibration is prior.calibration


def test_what_moved_before_and_within_is_told_apart(wu_scenario, array, prior):
    """A bias that moved since the prior, and another during the turn."""
    errors = moved(wu_scenario.errors, "bias", 1)
    recording = joined(turn(wu_scenario, errors, 9, 600), turn(wu_scenario, moved(errors, "bias", 3), 9, 600), 350)
    resolved = update_prior(recording, array, Known(prior))
    assert [(each.kind, each.sensor, each.since_s) for each in resolved.moved] == [
        ("bias", 2, None),
        ("bias", 4, recording.time_s[350]),
    ]
    found = fitted(resolved, array)
    truth = moved(errors, "bias", 3).to_vector()
    assert (np.abs(found.errors.to_vector() - truth)[1:] < 4.5 * found.standard_errors[1:]).all()


def test_what_no_sample_before_contradicts_was_so_from_the_start(wu_scenario, array, prior, monkeypatch):
    """Whatever time it is given: the whole recording counts."""
    recording = turn(wu_scenario, moved(wu_scenario.errors, "bias", 1), 5)
    monkeypatch.setattr(prior_changes, "time_of_change", lambda *_: recording.time_s[150])
    resolved = update_prior(recording, array, Known(prior))
    assert resolved.recording is recording and [each.since_s for each in resolved.moved] == [None]


def test_attitudes_that_jump_do_not_pass_for_noise(wu_scenario, prior):
    """Where none is stated, readings at rest in forty attitudes show a change of 20 nT and 1 nT of noise."""
    errors = moved(wu_scenario.errors, "bias", 1)
    recording = simulate(replace(wu_scenario, errors=errors, sample_count=40, seed=4)).recording
    array = Array(wu_scenario.array.positions_m)
    resolved = update_prior(recording, array, Known(prior))
    assert [(each.kind, each.sensor) for each in resolved.moved] == [("bias", 2)]
    assert fitted(resolved, array).array.vector_noise_T == pytest.approx(1e-9, rel=0.2)


GROUPS = {
    "a battery": ("biases", 0, [("bias", sensor) for sensor in (1, 2, 3, 4)]),
    "another sensor": ("several errors", 3, [(kind, 3) for kind in KINDS]),
    "the scalar": ("scalar reading, or the scale factors", 0, [("scale factor", sensor) for sensor in (1, 2, 3, 4)]),
}


@pytest.mark.parametrize(
    ("name", "times", "limit_deg"),
    [
        ("a battery", 0.5, 5.0),
        ("a battery", 100, 60.0),
        ("another sensor", 0.5, 60.0),
        ("another sensor", 100, 5.0),
        ("the scalar", 0.5, 5.0),
    ],
)
def test_what_moves_together_is_told_together(wu_scenario, array, prior, name, times, limit_deg):
    """By 10 nT or 2 µT, in a narrow turn and in a wide one: each part by its size, and all errors are as told."""
    kind, sensor, parts = GROUPS[name]
    errors = wu_scenario.errors
    for part in parts:
        if name == "the scalar":
            vector = errors.to_vector()
            vector[part[1] - 1, :3] *= 1 + times * SIZES["scale factor"]
            errors = SensorErrors.from_vector(vector)
        else:
            errors = moved(errors, part[0], part[1] - 1, times)
    resolved = update_prior(turn(wu_scenario, errors, 7, 600, limit_deg), array, Known(prior))
    assert [(each.kind, each.sensor, each.together) for each in resolved.moved] == [
        (*part, (kind, sensor)) for part in parts
    ]
    found = fitted(resolved, array)
    assert (np.abs(found.errors.to_vector() - errors.to_vector())[1:] < 4.5 * found.standard_errors[1:]).all()


def test_a_prior_of_which_nothing_is_left_counts_for_nothing(wu_scenario, array, prior):
    """Sensors that are all others, turned over the sphere: the calibration is the plain fit."""
    errors, rng = wu_scenario.errors, np.random.default_rng(9)
    vector = errors.to_vector() + rng.normal(size=(4, 12)) * np.repeat([0.01, 0.01, 5e-7, 0.01], 3)
    errors, _ = in_first_frame(SensorErrors.from_vector(vector))
    recording = simulate(replace(wu_scenario, errors=errors, sample_count=1000, seed=2)).recording
    resolved = update_prior(recording, array, Known(prior))
    assert {each.together for each in resolved.moved} == {("several errors", 0)} and len(resolved.moved) == 16
    found, plain = fitted(resolved, array), maximum_likelihood(recording, array)
    assert (np.abs(found.errors.to_vector() - plain.errors.to_vector()) <= 0.02 * plain.standard_errors + 1e-12).all()


def test_without_a_scalar_no_scale_is_told_to_have_changed(wu_scenario, array, prior):
    """Where nothing shows it: the scale of the prior stays, also where all else has changed."""
    names = [sizes[0].hypothesis.name for sizes in candidates_of(prior, False)]
    assert not any("scalar reading" in name for name in names) and names[-1] == "several errors of all sensors"
    spread = np.repeat([0, 0.01, 5e-7, 0.01], 3)
    vector = wu_scenario.errors.to_vector() + np.random.default_rng(9).normal(size=(4, 12)) * spread
    errors, _ = in_first_frame(SensorErrors.from_vector(vector))
    recording = simulate(replace(wu_scenario, errors=errors, sample_count=1000, seed=2)).recording
    resolved = update_prior(replace(recording, scalar_T=None), array, Known(prior))
    assert {each.together for each in resolved.moved} == {("several errors", 0)}
    found = fitted(resolved, array)
    assert found.standard_errors[:, :3].max() < 1e-4
    assert (np.abs(found.errors.to_vector() - errors.to_vector())[1:] < 4.5 * found.standard_errors[1:]).all()


def test_which_of_two_sensors_turned_stays_open(wu_scenario):
    """Of two the one turned against the other: both are told."""
    pair = Array(wu_scenario.array.positions_m[:2], wu_scenario.array.vector_noise_T[:2], 1e-10)
    scenario = replace(wu_scenario, array=pair, errors=SensorErrors.from_vector(wu_scenario.errors.to_vector()[:2]))
    array = pair.with_stated_noise()
    prior = prior_of(maximum_likelihood(simulate(scenario).recording, array), None, None)
    recording = turn(scenario, moved(scenario.errors, "misalignment", 1), 2)
    found = update_prior(recording, array, Known(prior)).moved[0]
    told = {(found.kind, found.sensor), *found.rivals}
    assert {("misalignment", 1), ("misalignment", 2)} <= told
    assert found.probability == pytest.approx(0.5, abs=0.1)


def test_samples_during_a_change_count_for_neither_side(wu_scenario, array, prior):
    """A bias that moves by 200 nT in a third of a second: all but some of these samples are left out."""
    times, lasts = 10, 3
    before, after = (
        turn(wu_scenario, each, 9, 600) for each in (wu_scenario.errors, moved(wu_scenario.errors, "bias", 3, times))
    )
    part = np.clip((np.arange(600) - 299) / lasts, 0, 1)[:, None, None]
    recording = replace(before, readings_T=(1 - part) * before.readings_T + part * after.readings_T)
    resolved = update_prior(recording, array, Known(prior))
    [found] = resolved.moved
    assert (found.kind, found.sensor, found.since_s) == ("bias", 4, resolved.recording.time_s[0])
    assert (np.abs(found.change - times * SIZES["bias"] * DIRECTION) < 4.5 * found.standard_errors).all()
    assert (found.standard_errors < 1e-9).all()
    assert resolved.earlier[0][0].sample_count == pytest.approx(300, abs=1)
    assert resolved.recording.sample_count == pytest.approx(301 - lasts, abs=1)
    calibration, truth = fitted(resolved, array), moved(wu_scenario.errors, "bias", 3, times).to_vector()
    assert (np.abs(calibration.errors.to_vector() - truth)[1:] < 4.5 * calibration.standard_errors[1:]).all()


def there_and_back(scenario, sensors, times):
    """Return a turn of 300 samples of which biases are others from sample 100 to 199."""
    errors = scenario.errors
    for sensor in sensors:
        errors = moved(errors, "bias", sensor, times)
    before, after = (turn(scenario, each, 9, 300, 30.0) for each in (scenario.errors, errors))
    return joined(joined(before, after, 100), before, 200)


@pytest.mark.parametrize(("sensors", "times"), [((3,), 1), ((0, 1, 2, 3), 100)])
def test_a_tool_that_is_picked_up_and_dropped_is_told_as_two_changes(wu_scenario, array, prior, sensors, times):
    """By 20 nT or 2 µT: where it may have moved more than once, each part beside what those before it tell."""
    recording = there_and_back(wu_scenario, sensors, times)
    resolved = update_prior(recording, array, Known(prior), MOST_CHANGES)
    assert MOST_CHANGES == 3
    assert [each.since_s for each in resolved.moved] == list(np.repeat(recording.time_s[[100, 200]], len(sensors)))
    assert {each.kind for each in resolved.moved} == {"bias"}
    found = fitted(resolved, array)
    difference = np.abs(found.errors.to_vector() - wu_scenario.errors.to_vector())
    assert (difference[1:] < 4.5 * found.standard_errors[1:]).all()
    assert len(update_prior(recording, array, Known(prior)).earlier) == 1


def test_a_further_change_after_which_no_fit_settles_is_none(wu_scenario, array, prior, monkeypatch):
    """What was found before it stays."""
    in_sequence = prior_changes._in_sequence

    def refused(parts, *rest):
        found = in_sequence(parts, *rest)
        return found if len(parts) == 2 else replace(found, refusal=Refused("the fit did not settle"))

    recording = there_and_back(wu_scenario, (3,), 1)
    monkeypatch.setattr(prior_changes, "_in_sequence", refused)
    resolved = update_prior(recording, array, Known(prior), 3)
    assert resolved.refusal is None and len(resolved.earlier) == 1


def test_a_time_that_does_not_settle_is_tried_five_times(wu_scenario, array, prior, monkeypatch):
    """First from a fiftieth of the recording before to one after the first estimate, then a sample later each time."""
    recording, asked = changed_within(wu_scenario, "bias", 1, 350), []

    def later(whole, *_):
        asked.append(whole)
        return 350 - len(asked), 351

    first = []
    monkeypatch.setattr(prior_changes, "samples_between", later)
    taken = prior_changes.posterior_of
    monkeypatch.setattr(prior_changes, "posterior_of", lambda part, *rest: first.append(part) or taken(part, *rest))
    resolved = update_prior(recording, array, Known(prior))
    assert (resolved.earlier[0][0].sample_count, resolved.recording.sample_count) == (345, 249) and len(asked) == 5
    assert {336, 240} <= {each.sample_count for each in first}


@pytest.mark.parametrize(("left", "count"), [(0.89, 10), (0.91, 1)])
def test_a_noise_is_scaled_down_until_it_settles(wu_scenario, prior, monkeypatch, left, count):
    """To a tenth, or ten times."""
    recording, asked = turn(wu_scenario, wu_scenario.errors, 3), []

    def less(_, noisy, *__):
        asked.append(noisy)
        return replace(noisy, vector_noise_T=left * noisy.vector_noise_T)

    monkeypatch.setitem(with_noise.__globals__, "noise_left_in", less)
    with_noise(recording, Array(wu_scenario.array.positions_m), Known(prior))
    assert len(asked) == count
