"""What effects added is worked out alike from all samples at once, from batches of any size, and where channels end."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.effects.removal import EffectStream, added_to, agreed_field, filled, of_sensors, on_sensors
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

COUNT = 240
ARRAY = Array.cross(0.5, 1e-9, 1e-10)
SHAPES = {
    "scale_step": {"time_s": 2.0, "end_s": 5.0},
    "gain_switching": {"on_1_s": 101.5, "off_1_s": 103.0, "on_2_s": 104.0, "off_2_s": 105.0},
    "temperature_drift": {"time_constant_s": 1.5, "inner_share": 0.3, "reference_C": 20.0, "start_s": 100.0},
    "current_interference": {"time_constant_s": 0.07, "reference_A": 1.0},
    "hysteresis": {"full_scale_T": 5e-5},
    "nonlinearity": {"full_scale_T": 5e-5},
    "bias_jump": {"time_s": 2.0, "end_s": 5.0},
    "periodic_interference": {"frequency_hz": 3.3, "start_s": 0.0},
    "platform_field": {"time_constant_s": 0.04},
}


def errors_of_cross():
    """Return errors of a few per cent and hundreds of nanotesla."""
    rng = np.random.default_rng(5)
    return SensorErrors(
        1 + 0.02 * rng.normal(size=(4, 3)),
        0.01 * rng.normal(size=(4, 3)),
        3e-7 * rng.normal(size=(4, 3)),
        0.01 * rng.normal(size=(4, 3)),
    )


ERRORS = errors_of_cross()


def recording_of_motion():
    """Return a recording in a field that turns, with all channels, at times with jitter."""
    rng = np.random.default_rng(6)
    time_s = 100.0 + np.cumsum(rng.uniform(0.01, 0.03, COUNT))
    phase = time_s - time_s[0]
    field = 5e-5 * np.column_stack([np.sin(1.3 * phase), np.cos(phase) * np.sin(phase / 3), np.cos(0.4 * phase)])
    temperature = 20 + np.cumsum(rng.normal(size=COUNT)) / 5
    current = 1 + (phase % 2 > 1) + 0.1 * rng.normal(size=COUNT)
    attitude = rng.normal(size=(COUNT, 4))
    attitude /= np.linalg.norm(attitude, axis=1)[:, None]
    further = {"current_2_A": current[::-1], "actuator_rudder": np.sin(2 * phase)}
    scalar = np.linalg.norm(field, axis=1)
    return Recording(time_s, ERRORS.distort(field), scalar, temperature, current, attitude, further)


RECORDING = recording_of_motion()
SPARSE = RECORDING.take(slice(None, None, 3))


def everything_of(name):
    """Return an effect that adds some hundreds of nanotesla by every term that it has at sensors and scalar."""
    effect = effect_named(name)
    channels = (RECORDING.temperature_C, RECORDING.current_A, RECORDING.attitude)
    field = agreed_field(RECORDING.readings_T, ERRORS, ARRAY)
    covariates = Covariates(RECORDING.time_s, field, ERRORS, ARRAY, *channels, further=RECORDING.further)
    shape = {key: value + (100.0 if key in ("time_s", "end_s") else 0.0) for key, value in SHAPES.get(name, {}).items()}
    rng = np.random.default_rng(7)
    contributions = []
    for term in effect.terms(covariates, shape):
        size = np.abs(term.features).max()
        values = rng.normal(size=len(term.coefficients)) * (1e-7 / size if size else 0)
        names = [coefficient.name for coefficient in term.coefficients]
        contributions.append(Contribution(term.sensor, term.axis, term.name, dict(zip(names, values, strict=True))))
    return FittedEffect(name, shape, tuple(contributions))


CAUSAL = sorted(
    name
    for name, effect in installed_effects().items()
    if isinstance(effect, LinearEffect)
    and effect.is_causal
    and not effect.is_of_site
    and name != "scalar_heading_error"
)
DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": 1.5, "reference_C": 20.0},
    (Contribution(1, 0, "offset", {"offset": 1e-8}), Contribution(1, 1, "scale", {"scale": 1e-4})),
)


def in_batches(effects, recording, sizes):
    """Return what a stream says of batches of these sizes, again and again, until the recording ends."""
    stream, rows, start, turn = EffectStream(effects, ERRORS, ARRAY), [], 0, 0
    while start < recording.sample_count:
        rows.append(stream.added(recording.take(slice(start, start + sizes[turn % len(sizes)]))).rows_T)
        start, turn = start + sizes[turn % len(sizes)], turn + 1
    return np.concatenate(rows)


@pytest.mark.parametrize("name", CAUSAL)
def test_one_sample_at_a_time_is_as_good_as_all_at_once(name):
    """Every effect that says it is causal can be taken off live, to rounding."""
    fitted = everything_of(name)
    at_once = added_to(SPARSE, [fitted], ERRORS, ARRAY)
    assert np.abs(at_once[:, :-1]).max() > 1e-9
    live = in_batches([fitted], SPARSE, [1])
    assert_allclose(live, at_once, rtol=1e-9, atol=1e-9 * np.abs(at_once).max())


@settings(deadline=None, max_examples=6)
@given(st.lists(st.integers(1, 60), min_size=1, max_size=8))
def test_batches_of_any_size_give_the_same(sizes):
    """Where the batches are cut does not matter, with several effects together."""
    effects = [DRIFT, everything_of("current_interference"), everything_of("hysteresis")]
    at_once = added_to(SPARSE, effects, ERRORS, ARRAY)
    assert_allclose(in_batches(effects, SPARSE, sizes), at_once, rtol=1e-9, atol=1e-9 * np.abs(at_once).max())


def test_what_was_added_in_the_true_situation_is_found_in_the_readings():
    """The field that an effect follows is found in readings that hold the effect, to a millionth of it."""
    field = agreed_field(RECORDING.readings_T, ERRORS, ARRAY)
    covariates = Covariates(RECORDING.time_s, field, ERRORS, ARRAY, RECORDING.temperature_C)
    effect = replace(DRIFT, contributions=(Contribution(1, 1, "scale", {"scale": 1e-4}),))
    added = effect_named("temperature_drift").signal(covariates, effect)
    disturbed = replace(RECORDING, readings_T=RECORDING.readings_T + added[:, :-1].reshape(COUNT, 4, 3))
    found = added_to(disturbed, [effect], ERRORS, ARRAY)
    assert_allclose(found, added, rtol=0, atol=1e-6 * np.abs(added).max())


def test_samples_without_the_channel_are_left_alone_and_the_lag_goes_on_behind_them():
    """Live, nothing is taken off where no temperature is known; behind, it is as if it had changed steadily between."""
    silent = slice(100, 150)
    temperature = RECORDING.temperature_C.copy()
    temperature[silent] = np.nan
    gappy = replace(RECORDING, temperature_C=temperature)
    stream = EffectStream([DRIFT], ERRORS, ARRAY)
    parts = [stream.added(gappy.take(slice(index, index + 1))) for index in range(COUNT)]
    is_known = np.concatenate([part.is_known[:, 0] for part in parts])
    rows = np.concatenate([part.rows_T for part in parts])
    assert_array_equal(is_known, np.isfinite(temperature))
    assert not rows[silent].any()
    offline = added_to(gappy, [DRIFT], ERRORS, ARRAY)
    assert_allclose(rows[is_known], offline[is_known], rtol=1e-9, atol=1e-9 * np.abs(offline).max())


def test_a_run_that_starts_over_forgets_the_one_before():
    """When stamps go back, as a bag is played again, the second run gives what the first gave."""
    stream = EffectStream([DRIFT], ERRORS, ARRAY)
    first, second = (stream.added(RECORDING).rows_T for _ in range(2))
    assert_array_equal(second, first)


def test_a_missing_channel_is_named():
    """A recording without temperature is refused, with the effect and what to record."""
    with pytest.raises(InputError, match="temperature_drift is to be taken off, which needs the temperature"):
        added_to(replace(RECORDING, temperature_C=None), [DRIFT], ERRORS, ARRAY)


def test_effects_without_a_signal_are_refused():
    """Nothing tells what outliers added to which sample."""
    spikes = FittedEffect("outliers", {}, (Contribution(0, 0, "spikes", {"rate": 0.1, "size": 1e-8}),))
    with pytest.raises(InputError, match="cannot be taken off"):
        EffectStream([spikes], ERRORS, ARRAY)
    assert on_sensors(spikes) is None


def test_only_what_goes_with_the_array_is_of_the_sensors():
    """The gradient of the site and what acts on the scalar alone stay where they are."""
    of_site = FittedEffect("ambient_gradient", {}, (Contribution(ALL, None, "degree 2", {}),))
    current = FittedEffect(
        "current_interference",
        {"reference_A": 0.0},
        (Contribution(0, 0, "field", {"field": 1e-9}), Contribution(SCALAR, None, "field", {"field x": 1e-9})),
    )
    (kept,) = of_sensors([of_site, current])
    assert kept.effect == "current_interference"
    assert [one.sensor for one in kept.contributions] == [0]
    scalar_alone = replace(current, contributions=current.contributions[1:])
    assert of_sensors([scalar_alone]) == ()


@pytest.mark.parametrize("part", range(4))
@pytest.mark.parametrize("known", [[0], [3, 5], []])
def test_attitudes_that_are_unknown_in_part_are_filled_as_others_are(part, known):
    """From the nearest that is known in whole; where none is, there is no attitude."""
    attitude = np.random.default_rng(2).normal(size=(RECORDING.sample_count, 4))
    attitude[~np.isin(np.arange(len(attitude)), known), part] = np.nan
    result = filled(replace(RECORDING, attitude=attitude)).attitude
    assert result is None if not known else np.isin(result[:, 0], attitude[known, 0]).all()


def test_holes_of_channels_are_filled_from_their_neighbours():
    """A temperature between two others lies between them; an attitude is that of the nearest sample."""
    temperature = np.full(COUNT, np.nan)
    temperature[[10, 20]] = 10.0, 30.0
    attitude = np.full((COUNT, 4), np.nan)
    attitude[5], attitude[200] = [0, 0, 0, 1], [1, 0, 0, 0]
    result = filled(replace(RECORDING, temperature_C=temperature, attitude=attitude))
    time_s = RECORDING.time_s
    expected = 10 + 20 * (time_s[14] - time_s[10]) / (time_s[20] - time_s[10])
    assert result.temperature_C[14] == pytest.approx(expected)
    assert (result.temperature_C[0], result.temperature_C[-1]) == (10.0, 30.0)
    assert_array_equal(result.attitude[[0, 50, 150, 239]], [[0, 0, 0, 1]] * 2 + [[1, 0, 0, 0]] * 2)


def test_channels_of_several_components_are_filled_and_turns_are_not():
    """Each component of a position lies on its own line; an angular velocity that is missing stays so."""
    position = np.full((COUNT, 3), np.nan)
    position[[10, 20]] = [0.0, 1.0, 2.0], [10.0, 1.0, 0.0]
    rates = np.zeros((COUNT, 3))
    rates[5] = np.nan
    result = filled(replace(RECORDING, position_m=position, angular_velocity_rad_s=rates))
    part = (RECORDING.time_s[14] - RECORDING.time_s[10]) / (RECORDING.time_s[20] - RECORDING.time_s[10])
    np.testing.assert_allclose(result.position_m[14], [10 * part, 1.0, 2 - 2 * part])
    assert np.isnan(result.angular_velocity_rad_s[5]).all()
