"""A calibration fitted together with effects finds the truth of both, with errors that hold what is not known."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter

from tam_calibration.fit import calibrate
from tam_calibration.fit.consistency import LOOK_FOR_CAUSE, is_unexplained, naming_causes
from tam_calibration.gap.calibration_with_effects import IN_WORLD, calibrate_with_effects, explained
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Temperature

OFFSET_T_PER_K, SCALE_PER_K, TIME_CONSTANT_S, TRUE_REFERENCE_C = 1.5e-9, 2e-5, 20.0, 22.0
DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": TIME_CONSTANT_S, "reference_C": TRUE_REFERENCE_C},
    (
        Contribution(1, 0, "offset", {"offset": OFFSET_T_PER_K}),
        Contribution(1, 0, "scale", {"scale": SCALE_PER_K}),
    ),
)


def scenario(seed=1, count=1000):
    """Return a run of 200 s in which sensor 2 drifts with a temperature that is known without error."""
    plan = read_scenario("warming_up")
    temperature = Temperature(18.0, 26.0)
    return replace(plan, effects=(DRIFT,), temperature=temperature, sample_count=count, rate_hz=count / 200, seed=seed)


@pytest.fixture(scope="module")
def made():
    """Return one simulation."""
    return simulate(scenario())


@pytest.fixture(scope="module")
def calibration(made):
    """Return its calibration with the drift."""
    return calibrate_with_effects(made.recording, made.scenario.array, ["temperature_drift"])


@pytest.mark.parametrize("fault", ["spikes", "stuck"])
def test_bad_readings_bend_neither_errors_nor_effect(made, calibration, fault):
    """They are left out as without effects."""
    readings_T = made.recording.readings_T.copy()
    for start in (100, 350, 600, 800):
        if fault == "spikes":
            readings_T[start, 0] += 3e-6
        else:
            readings_T[start : start + 15, 2] = readings_T[start, 2]
    bad = replace(made.recording, readings_T=readings_T)
    found = calibrate_with_effects(bad, made.scenario.array, ["temperature_drift"])
    assert any("contradict the others and are left out" in note for note in found.notes)
    assert found.quality.grade == calibration.quality.grade
    moved = found.errors.to_vector() - calibration.errors.to_vector()
    assert np.all(np.abs(moved) <= 1.5 * calibration.standard_errors)


def test_errors_and_effect_are_as_far_from_the_truth_as_their_standard_errors_say():
    """Over recordings the deviations of parameters and coefficients have the standard deviations that are stated."""
    of_errors, of_effect, of_shape = [], [], []
    for seed in range(20):
        made = simulate(scenario(seed))
        found = calibrate_with_effects(made.recording, made.scenario.array, ["temperature_drift"])
        (effect,) = found.effects
        terms = {(one.axis, one.term): one for one in effect.contributions}
        above = effect.shape["reference_C"] - TRUE_REFERENCE_C
        truth = made.errors.to_vector()
        truth[1, 6] += OFFSET_T_PER_K * above
        truth[1, 0] += SCALE_PER_K * above
        is_free = found.standard_errors > 0
        of_errors.append(
            ((found.errors.to_vector() - truth) / np.where(is_free, found.standard_errors, np.inf)).ravel()
        )
        if set(terms) == {(0, "offset"), (0, "scale")}:
            for term, name, true in (("offset", "offset", OFFSET_T_PER_K), ("scale", "scale", SCALE_PER_K)):
                one = terms[0, term]
                of_effect.append((one.values[name] - true) / one.standard_errors[name])
            shape, error = effect.shape["time_constant_s"], effect.shape_errors["time_constant_s"]
            of_shape.append((shape - TIME_CONSTANT_S) / error)
    free = np.array(of_errors)[:, is_free.ravel()]
    assert np.sqrt(np.mean(free**2)) == pytest.approx(1, abs=0.1)
    assert np.abs(np.mean(free, axis=0)).max() < 4 / np.sqrt(20)
    assert len(of_shape) > 10
    assert np.sqrt(np.mean(np.square(of_effect))) == pytest.approx(1, abs=0.4)
    assert np.sqrt(np.mean(np.square(of_shape))) == pytest.approx(1, abs=0.6)


def test_what_is_not_known_of_the_effect_is_in_the_covariance_of_the_errors(calibration, made):
    """The bias of the axis that drifts is known less well than without the drift, other sensors as well."""
    plain = calibrate(simulate(replace(made.scenario, effects=())).recording, made.scenario.array)
    ratio = calibration.standard_errors / np.where(plain.standard_errors > 0, plain.standard_errors, 1)
    assert ratio[1, 6] > 1.2
    assert_allclose(ratio[2:], np.where(plain.standard_errors[2:] > 0, 1, 0), atol=0.1)
    assert not calibration.standard_errors[0, 9:].any() and not calibration.errors.misalignment[0].any()


def test_residuals_are_noise_and_the_size_is_that_of_the_drift(calibration, made):
    """What is left is white noise; the size that is kept is the drift's part in the mean of four sensors."""
    assert calibration.reduced_chi_square["differential"] == pytest.approx(1, abs=0.1)
    assert calibration.samples == made.recording.sample_count
    assert calibration.warnings == ()
    clean = calibration.without_effects(made.recording).readings_T
    added = (made.recording.readings_T - clean)[:, 1, 0]
    assert calibration.effect_sizes[0].rms[0] == pytest.approx(np.sqrt(np.mean(added**2)) / 4, rel=0.1)
    size = calibration.effect_sizes[0]
    clean = simulate(replace(made.scenario, effects=())).recording.readings_T
    drift = (made.recording.readings_T - clean)[:, 1, 0]
    assert 0 < size.standard_errors[0] < 0.25 * size.rms[0]
    assert abs(size.rms[0] - np.sqrt(np.mean(drift**2)) / 4) < 3 * size.standard_errors[0]


def test_standard_errors_hold_what_else_is_in_the_data():
    """A drift beside slow noise of 3 nT in its axis is no more errors off than they say; by white noise it would be."""
    pulls, narrow = [], []
    for seed in range(12):
        made = simulate(scenario(seed, 600))
        generator = np.random.default_rng(seed)
        slow = lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], generator.normal(size=2600))[2000:]
        readings = made.recording.readings_T.copy()
        readings[:, 1, 0] += 3e-9 * slow
        recording = replace(made.recording, readings_T=readings)
        found = calibrate_with_effects(recording, made.scenario.array, ["temperature_drift"])
        for one in found.effects[0].contributions:
            if (one.sensor, one.axis, one.term) == (1, 0, "offset"):
                deviation = one.values["offset"] - OFFSET_T_PER_K
                pulls.append(deviation / one.standard_errors["offset"])
                narrow.append(deviation / (1e-9 / np.sqrt(600) / np.std(recording.temperature_C)))
    assert len(pulls) > 8
    assert np.sqrt(np.mean(np.square(pulls))) < 1.5
    assert np.sqrt(np.mean(np.square(narrow))) > 3


def test_auto_finds_the_drift(calibration, made):
    """What a diagnosis finds is what is kept when no effect is named."""
    found = calibrate_with_effects(made.recording, made.scenario.array, ["auto"])
    assert [one.effect for one in found.effects] == ["temperature_drift"]
    difference = found.errors.to_vector() - calibration.errors.to_vector()
    assert (np.abs(difference) <= 0.2 * calibration.standard_errors).all()


def test_auto_of_a_clean_recording_is_the_plain_calibration(made):
    """Where nothing is found nothing is kept."""
    recording = simulate(replace(made.scenario, effects=())).recording
    found = calibrate_with_effects(recording, made.scenario.array, ["auto"])
    plain = calibrate(recording, made.scenario.array)
    assert found.effects == () and found.effect_sizes == ()
    np.testing.assert_array_equal(found.errors.to_vector(), plain.errors.to_vector())
    np.testing.assert_array_equal(found.covariance, plain.covariance)


def test_without_scalar_the_scale_is_the_convention(made):
    """Without scalar reference the determinants have the geometric mean 1, and the drift is found all the same."""
    recording = replace(made.recording, scalar_T=None)
    found = calibrate_with_effects(recording, made.scenario.array, ["temperature_drift"])
    assert np.mean(np.log(np.linalg.det(found.errors.matrix))) == pytest.approx(0, abs=1e-12)
    terms = {(one.axis, one.term): one for one in found.effects[0].contributions}
    offset = terms[0, "offset"]
    assert offset.values["offset"] == pytest.approx(OFFSET_T_PER_K, abs=5 * offset.standard_errors["offset"])


def test_noise_that_is_not_stated_is_that_without_the_effect(made):
    """The noise is estimated from what is left without the drift."""
    array = Array(made.scenario.array.positions_m, None, 1e-10)
    found = calibrate_with_effects(made.recording, array, ["temperature_drift"])
    assert found.noise_is_estimated
    assert_allclose(found.array.vector_noise_T, 1e-9, rtol=0.15)


@pytest.mark.parametrize(
    ("names", "problem", "words"),
    [
        (["tides"], InputError, "there is no effect 'tides'"),
        (["current_interference"], InputError, "current_interference cannot be fitted: it needs the current channel"),
        (["auto", "hysteresis"], InputError, "name no others beside it"),
        (["saturation"], Refused, "saturation is not in this recording"),
    ],
)
def test_what_cannot_be_fitted_is_refused(made, names, problem, words):
    """The sentence names the effect and what hinders."""
    with pytest.raises(problem, match=words):
        calibrate_with_effects(made.recording, made.scenario.array, names)


def test_what_a_recording_cannot_show_is_refused(made):
    """A temperature that does not change shows no drift, and the refusal says what would."""
    still = replace(made.recording, temperature_C=np.full(made.recording.sample_count, 20.0))
    with pytest.raises(Refused, match="temperature changes by 0 K only; let the temperature change"):
        calibrate_with_effects(still, made.scenario.array, ["temperature_drift"])


def test_another_array_is_refused(made):
    """The number of sensors must be that of the array."""
    with pytest.raises(InputError, match="use the array file of this recording"):
        calibrate_with_effects(made.recording, Array(np.zeros((2, 3))), ["auto"])


def test_attitude_calibrates_a_sensor_whose_intensity_does_not(lone):
    """Turned within a narrow cone: errors are as far from the truth as their standard errors say, over recordings."""
    pulls = []
    for seed in range(6):
        made = lone(1500, noise_T=3e-8, seed=seed)
        narrow = made.field_T[:, 2] > 0.85 * made.world.intensity_T
        recording = made.recording.take(narrow)
        with pytest.raises(InputError):
            calibrate(recording, made.array)
        found = calibrate_with_effects(recording, made.array, ["auto"])
        assert found.method == IN_WORLD and found.effects == ()
        is_free = found.standard_errors[0] > 0
        pulls.append(
            (found.errors.to_vector() - made.errors.to_vector())[0, is_free] / found.standard_errors[0, is_free]
        )
    assert np.sqrt(np.mean(np.square(pulls))) == pytest.approx(1, abs=0.25)


def test_a_delay_beside_the_attitude_stays_in_corrected_data(lone):
    """To take it off by the readings of the sensor itself would add more noise; the calibration is without it."""
    made = lone(noise_T=1e-7)
    late = np.array([np.interp(made.recording.time_s - 0.02, made.recording.time_s, of) for of in made.field_T.T]).T
    found = calibrate_with_effects(made.with_added(late - made.field_T).recording, made.array, ["time_skew"])
    assert found.method == IN_WORLD and found.effects == () and "left in corrected data" in found.warnings[-1]
    pulls = (found.errors.to_vector() - made.errors.to_vector()) / np.maximum(found.standard_errors, 1e-12)
    assert np.abs(pulls).max() < 4.5


def test_a_magnet_that_comes_and_goes_is_kept_with_the_calibration(lone):
    """One sensor with attitude: the jump is taken off, the errors are those without it."""
    made = lone()
    added = np.zeros((made.recording.sample_count, 3))
    added[300:600, 2] = 27e-6
    found = calibrate_with_effects(made.with_added(added).recording, made.array, ["auto"])
    assert found.method == IN_WORLD and [one.effect for one in found.effects] == ["bias_jump"]
    pulls = (found.errors.to_vector() - made.errors.to_vector()) / np.where(
        found.standard_errors > 0, found.standard_errors, np.inf
    )
    assert np.abs(pulls).max() < 4


def test_standard_errors_by_attitude_do_not_ask_for_the_stated_noise(lone):
    """They are scaled by the residual: a sheet that states 1.6 times the noise makes them no larger."""
    made = lone(1500, noise_T=3e-8)
    recording = made.recording.take(made.field_T[:, 2] > 0.85 * made.world.intensity_T)
    sheets = [replace(made.array, vector_noise_T=factor * made.array.vector_noise_T) for factor in (1.0, 1.6)]
    found = [calibrate_with_effects(recording, sheet, ["auto"]) for sheet in sheets]
    assert [one.method for one in found] == [IN_WORLD, IN_WORLD]
    assert_allclose(found[0].standard_errors, found[1].standard_errors, rtol=0.02)


@pytest.fixture(scope="module")
def turning():
    """Return a turning array and its recording."""
    return simulate(replace(read_scenario("tumble_100_hz"), sample_count=450, rate_hz=30.0))


def reasons_of(turning, readings_T):
    """Return the reasons to doubt a calibration of readings, with their causes."""
    recording, array = replace(turning.recording, readings_T=readings_T), turning.scenario.array
    calibration = calibrate(recording, array)
    assert is_unexplained(calibration.warnings)
    return replace(calibration, warnings=explained(calibration.warnings, recording, array)).quality


def test_a_tone_is_named_with_the_command_that_takes_it_off(turning):
    """The effect, the sensor, and what to do."""
    readings_T = turning.recording.readings_T.copy()
    readings_T[:, 1, 0] += 20e-9 * np.sin(2 * np.pi * 7.3 * turning.recording.time_s)
    quality = reasons_of(turning, readings_T)
    assert quality.grade == "doubtful" and "periodic interference in sensor 2 explains it" in quality.reasons[0]
    assert quality.next[0] == "fit that too, with --effects periodic_interference"


def test_noise_that_was_stated_too_small_is_told_with_its_size(turning):
    """It is no effect: the array file should state it."""
    noise_T = 2e-9 * np.random.default_rng(2).normal(size=turning.recording.readings_T.shape)
    quality = reasons_of(turning, turning.recording.readings_T + noise_T)
    assert "white noise of 2.1" in quality.reasons[0] and quality.next[0] == "state that noise in the array file"


def test_noise_as_stated_explains_no_residual(turning):
    """A diagnosis that finds no more than the stated noise leaves the residual open."""
    recording, array = turning.recording, turning.scenario.array
    (doubt,) = explained([f"the residual is large: {LOOK_FOR_CAUSE}"], recording, array)
    assert doubt.startswith("the residual is large; no noise or known effect explains it")
    assert doubt.endswith("see where and when it is, with tam diagnose --report")


def test_what_no_effect_explains_is_said(turning):
    """A slow course that no channel has."""
    time_s = turning.recording.time_s - turning.recording.time_s[0]
    course = np.sin(2 * np.pi * time_s / 7.0) * np.sign(np.sin(2 * np.pi * time_s / 3.1))
    readings_T = turning.recording.readings_T.copy()
    readings_T[:, 2, 1] += 30e-9 * course
    quality = reasons_of(turning, readings_T)
    assert quality.grade == "doubtful" and "explains" in quality.reasons[0] and "tam diagnose" not in quality.next


def named(recording, array):
    """Return the calibration whose doubts or refusal name their cause."""
    return naming_causes(lambda: calibrate(recording, array), partial(explained, samples=recording, array=array))


def test_a_field_that_drifts_is_no_doubt_where_the_drift_is_fitted(turning):
    """Without a scalar the first reason is the cure that works: a change of the field is none of the gains."""
    course = np.sin(3 * turning.recording.time_s / turning.recording.time_s[-1]) ** 2
    field_T = turning.recording.readings_T - turning.errors.bias_T
    drifting_T = turning.recording.readings_T + 2e-4 * course[:, None, None] * field_T
    recording, array = replace(turning.recording, readings_T=drifting_T, scalar_T=None), turning.scenario.array
    quality = named(recording, array).quality
    assert quality.next[0] == "fit that too, with --effects geomagnetic_drift"
    assert "against the fitted intensity" in quality.reasons[0]
    found = calibrate_with_effects(recording, array, ["geomagnetic_drift"])
    assert found.quality.grade == "good", found.quality
    assert found.reduced_chi_square["common_mode"] == pytest.approx(1, abs=0.25)
    assert found.residuals(recording).center_intensity_T.std() == pytest.approx(found.in_sample.center_intensity_T)


@pytest.mark.parametrize(("size_T", "is_refused"), [(1.3e-9, True), (0.7e-9, False)])
def test_a_change_that_an_effect_explains_is_told_with_its_command(size_T, is_refused):
    """A bias that drifts with a recorded temperature is no change between two parts, which would drift too."""
    made = simulate(replace(scenario(), effects=()))
    generator, time_s = np.random.default_rng(3), made.recording.time_s
    rise_K = time_s / 25.0 + 1.5 * np.sin(2 * np.pi * time_s / 93.0)
    readings_T = made.recording.readings_T.copy()
    readings_T[:, 1] += size_T * np.outer(rise_K, [1.0, -0.6, 0.0])
    temperature_C = 20.0 + rise_K + 0.02 * generator.normal(size=len(rise_K))
    recording, array = replace(made.recording, readings_T=readings_T, temperature_C=temperature_C), made.scenario.array
    if is_refused:
        with pytest.raises(Refused) as refusal:
            named(recording, array)
        told = str(refusal.value)
    else:
        told = named(recording, array).quality.reasons[0]
    assert told.endswith("; temperature drift in sensor 2 explains it: fit that too, with --effects temperature_drift")
    assert calibrate_with_effects(recording, array, ["temperature_drift"]).quality.grade == "good"
