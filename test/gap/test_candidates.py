"""Recordings that could be made next are such that people can make them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.library import effect_named
from tam_calibration.gap.candidates import Setting, _world_field, candidates, expected_evidence
from tam_calibration.gap.model import Model, Part


@pytest.mark.parametrize(("step_s", "shortest_s"), [(0.05, 3.5), (1.0, 16.0)])
def test_hands_turn_an_array_within_some_seconds(run, step_s, shortest_s):
    """A fast turn takes about five, as a pose is held, but more where sixteen samples of it last longer."""
    now = replace(run(60).channels().covariates, time_s=step_s * np.arange(60))
    fast = {one.path: one.turn_s for one in candidates(now, ())}
    assert shortest_s <= fast["back and forth"] == fast["swings"] <= max(7.0, shortest_s)
    assert 3.5 <= fast["poses"] <= 7.0


def test_people_are_told_how_long_turns_and_changes_take(run):
    """In seconds of a turn; what the temperature does takes thirty turns, the current ten."""
    now = replace(run(60).channels().covariates, time_s=0.05 * np.arange(60), temperature_C=None, current_A=None)
    words = {one.path: one.words for one in candidates(now, ())}
    fast = max(5.0, 16 * 0.05)
    assert f"in swings back and forth, small and large, of {3 * fast:.0f} s each" in words["swings"]
    assert f"turn it fast through all directions ({fast:.0f} s a turn)" in words["back and forth"]
    (warm,), (switched,) = candidates(now, ("temperature_C",)), candidates(now, ("current_A",))
    assert (warm.path, warm.changes) == ("onwards", ("temperature_C",))
    assert warm.minutes == pytest.approx(30 * warm.turn_s / 60)
    assert switched.minutes == pytest.approx(10 * switched.turn_s / 60)


def test_without_an_attitude_the_field_is_that_of_middle_latitudes(run):
    """Sixty degrees down and to the north, as strong as in the recording."""
    now = replace(run(60).channels().covariates, attitude=None)
    field = _world_field(now)
    assert field / np.mean(now.intensity_T) == pytest.approx([0.0, 0.5, -np.sqrt(0.75)])


@pytest.mark.parametrize("every", [1, 4])
def test_a_simulated_recording_has_the_scalar_as_often_as_the_one_at_hand(run, every):
    """Its readings are those of the field, and of what an effect adds; without an effect they fit exactly."""
    made = run(240)
    scalar_T = np.where(np.arange(240) % every == 0, made.recording.scalar_T, np.nan)
    model = replace(made, recording=replace(made.recording, scalar_T=scalar_T)).model()
    now = model.base().channels.covariates
    setting = Setting(model, now, 1.0)
    channels = setting.channels(now)
    assert np.abs(channels.residuals.row_shift_T[:, :-1]).max() < 1e-12
    assert channels.count == pytest.approx(240 * 9 + 240 / every)
    moved = setting.channels(now, 1e-6 * (np.arange(13) == 4))
    assert np.abs(moved.residuals.row_shift_T[:, 4]).max() > 1e-7


def test_a_channel_that_an_effect_follows_now_and_then_is_there_in_the_next_recording(run):
    """The vehicle's field may be that of a current; told apart it is from a step where the current is switched."""
    made = run(240)
    now = replace(made.channels().covariates, current_A=np.repeat([1.0, 3.0], 120))
    field = Part(effect_named("platform_field"), {}, ((0, None, "current_A"),), np.full(3, 1e-8))
    step = Part(effect_named("bias_jump"), {"time_s": float(now.time_s[120])}, ((0, 0, "offset"),), np.full(1, 2e-8))
    assert field.channels == {"current_A"} and step.channels == set()
    setting = Setting(made.model(), now, 1.0)
    (switched,) = candidates(now, ("current_A",))
    assert expected_evidence(setting, field, step, switched, is_nested=False) > 100


def test_beside_the_field_of_the_world_a_simulated_recording_has_no_scalar(lone):
    """Its readings fit exactly; an intensity that rises by 50 nT is as readings that are too small by as much."""
    made = lone(300, noise_T=1e-9)
    model = Model.nominal(made.recording, made.array)
    setting = Setting(model, model.base().channels.covariates, 1.0)
    assert model.world is not None
    onwards = candidates(setting.covariates, ())[0].covariates(setting.covariates, {"attitude"})
    assert onwards.attitude is not None
    assert setting.channels(onwards).energy == pytest.approx(0, abs=1e-3 * onwards.sample_count)
    risen = setting.channels(onwards, 5e-8 * (np.arange(4) == 3))
    direction = onwards.field_T @ model.errors.matrix[0].T / model.intensity_T
    smaller = -5e-8 * np.column_stack([direction, np.zeros(onwards.sample_count)])
    assert_allclose(risen.differential, setting.channels(onwards, smaller).differential, atol=1e-3)
    assert np.abs(risen.differential).max() > 10
