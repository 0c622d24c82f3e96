"""Samples are corrected as they arrive as all of them would be, and what stays in is told and counted."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.correction.parts import EffectSize
from tam_calibration.correction.streaming import Correction, EffectRemoval, PartialCorrection
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect

DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": 0.5, "reference_C": 20.0},
    (Contribution(1, 0, "offset", {"offset": 1e-9}),),
)
LATE = FittedEffect("time_skew", {}, (Contribution(2, None, "delay", {"delay": 1e-3}),))
SIZE = EffectSize(np.full(9, 3e-9), np.full(9, 1e-10))


@pytest.fixture(scope="module")
def warming(recording):
    """Return the recording with a temperature that rises."""
    return replace(recording, temperature_C=np.linspace(15, 25, recording.sample_count))


@pytest.fixture(scope="module")
def plain(recording, cross):
    """Return a calibration without effects."""
    return calibrate(recording, cross)


@pytest.fixture(scope="module")
def keeping(plain):
    """Return the calibration that keeps a drift."""
    return replace(plain, effects=(DRIFT,), effect_sizes=(SIZE,))


def live(calibration, recording):
    """Return the batches of one sample each."""
    correction = Correction(calibration)
    return [correction.correct(recording.take(slice(index, index + 1))) for index in range(recording.sample_count)]


def test_sample_by_sample_is_as_good_as_the_whole_recording(keeping, warming):
    """Outputs and standard errors are those of `Calibration.correct`."""
    warming = warming.take(slice(150))
    batches = live(keeping, warming)
    offline = keeping.correct(warming)
    assert_allclose(np.concatenate([batch.outputs for batch in batches]), offline.outputs, rtol=1e-9, atol=1e-18)
    assert_allclose(batches[-1].standard_errors[0], offline.standard_errors)
    assert not any(batch.left_in for batch in batches)


def test_without_effects_nothing_changes(plain, warming):
    """A calibration without effects gives the same bits live, offline and as before effects could be kept."""
    warming = warming.take(slice(150))
    outputs = np.concatenate([batch.outputs for batch in live(plain, warming)])
    assert_array_equal(outputs, plain.apply(warming.readings_T))
    assert_array_equal(plain.correct(warming).outputs, plain.apply(warming.readings_T))
    assert plain.without_effects(warming) is warming


def test_the_effect_is_taken_off_the_readings(keeping, plain, warming):
    """The corrected field is that of readings without the drift; a kept effect makes the standard errors larger."""
    clean = keeping.without_effects(warming)
    change = warming.readings_T - clean.readings_T
    assert np.abs(change[:, 1, 0]).max() > 4e-9
    change[:, 1, 0] = 0
    assert not change.any()
    assert_allclose(keeping.correct(warming).outputs, plain.apply(clean.readings_T), rtol=1e-12)
    assert_allclose(keeping.output_standard_errors, np.hypot(plain.output_standard_errors, SIZE.standard_errors))


def test_a_silent_channel_leaves_the_effect_in_and_says_so(keeping, plain, recording):
    """Without temperature the outputs are those without effects, with errors that hold the size of the drift."""
    correction = Correction(keeping)
    batch = correction.correct(recording)
    assert batch.left_in == ("temperature_drift",)
    assert_array_equal(batch.outputs, plain.apply(recording.readings_T))
    assert_allclose(batch.standard_errors[0], np.hypot(keeping.output_standard_errors, SIZE.rms))
    assert correction.why_left_in("temperature_drift") == "temperature_drift needs the temperature, and none arrives"
    with pytest.raises(InputError, match="no such channel"):
        keeping.correct(recording)


def test_the_scalar_is_told_without_its_effects(plain, recording):
    """What a vehicle adds to the scalar alone is taken off it live, and changes no output."""
    contribution = Contribution(SCALAR, None, "permanent", {"permanent x": 1e-7})
    of_scalar = FittedEffect("platform_field", {"time_constant_s": 0.1}, (contribution,))
    calibration = replace(plain, effects=(of_scalar,), effect_sizes=(EffectSize(np.zeros(9), np.zeros(9)),))
    batch = Correction(calibration).correct(recording)
    assert_allclose(batch.scalar_T, calibration.without_effects(recording).scalar_T, rtol=1e-12)
    assert np.ptp(batch.scalar_T - recording.scalar_T) > 1e-8
    assert_array_equal(batch.outputs, plain.apply(recording.readings_T))


def test_an_effect_that_needs_later_samples_is_left_in_live_and_taken_off_offline(plain, warming):
    """A delay cannot be taken off at once, a recording it can: other effects are taken off all the same."""
    both = replace(plain, effects=(LATE, DRIFT), effect_sizes=(SIZE, SIZE))
    batch = Correction(both).correct(warming)
    assert batch.left_in == ("time_skew",)
    only_drift = replace(plain, effects=(DRIFT,), effect_sizes=(SIZE,))
    assert_allclose(batch.outputs, only_drift.correct(warming).outputs, rtol=1e-12)
    assert np.abs(both.correct(warming).outputs - batch.outputs).max() > 1e-9
    assert "needs later samples" in Correction(both).why_left_in("time_skew")


def test_effects_are_taken_off_where_a_sensor_is_missing(keeping, plain, warming):
    """Live as offline, to what the other sensors tell without the effect; the errors are those of these sensors."""
    drifting = warming.readings_T.copy()
    drifting[:, 1, 0] += 1e-8 * (warming.temperature_C - 20.0)
    contribution = replace(DRIFT.contributions[0], values={"offset": 1e-8})
    fitted = replace(DRIFT, shape={"time_constant_s": 1e-3, "reference_C": 20.0}, contributions=(contribution,))
    calibration = replace(keeping, effects=(fitted,))
    codes = np.where(np.arange(600) < 200, 0, 4)
    recording, partial = replace(warming, readings_T=drifting), PartialCorrection(calibration)
    offline = partial.correct(recording, codes)
    correction = Correction(calibration)
    batches = []
    for part in (slice(0, 150), slice(150, 400), slice(400, 600)):
        some = recording.take(part)
        filled = replace(some, readings_T=partial.filled(some.readings_T, codes[part]))
        batches.append(correction.correct(filled, codes[part]))
    live = np.concatenate([batch.outputs for batch in batches])
    errors = np.concatenate([batch.standard_errors for batch in batches])
    assert_allclose(live, offline.outputs, rtol=1e-9, atol=1e-18)
    assert_allclose(errors[0], calibration.output_standard_errors)
    assert_allclose(errors[-1], partial.without(4).standard_errors)
    expected = plain.apply(warming.readings_T)
    PartialCorrection(plain).put(expected, warming.readings_T, codes)
    assert_allclose(live[:, :3], expected[:, :3], rtol=0, atol=2e-11)


def test_an_effect_that_stays_in_counts_as_the_noise_of_those_that_are_left(keeping, warming):
    """Its size grows in the errors by what the noise grows."""
    silent = replace(warming, temperature_C=None)
    codes = np.full(600, 8)
    batch = Correction(keeping).correct(silent, codes)
    growth = PartialCorrection(keeping).growth(codes)[0]
    own = PartialCorrection(keeping).without(8).standard_errors
    assert batch.left_in == ("temperature_drift",)
    assert_allclose(batch.standard_errors[0], np.sqrt(own**2 + growth * SIZE.rms**2))
    assert growth[6] == pytest.approx(3.0, rel=0.05)


def test_a_new_calibration_goes_on_with_the_memory_of_effects(keeping, warming):
    """Where the same effect stays, the next outputs jump by the change of the errors alone."""
    before, after = Correction(keeping), Correction(keeping)
    before.correct(warming.take(slice(300)))
    after.go_on(before)
    later, anew = warming.take(slice(300, None)), Correction(keeping)
    expected = keeping.correct(warming).outputs[300:]
    assert_allclose(after.correct(later).outputs, expected, rtol=1e-9, atol=1e-18)
    assert np.abs(anew.correct(later).outputs - expected).max() > 1e-12


def test_other_effects_begin_anew(keeping, warming):
    """A calibration whose effect is another one has nothing to go on with."""
    before = Correction(keeping)
    before.correct(warming.take(slice(300)))
    stronger = replace(DRIFT, contributions=(Contribution(1, 0, "offset", {"offset": 2e-9}),))
    other = replace(keeping, effects=(stronger,))
    after, anew, later = Correction(other), Correction(other), warming.take(slice(300, None))
    after.go_on(before)
    assert_array_equal(after.correct(later).outputs, anew.correct(later).outputs)


def test_an_effect_is_taken_off_batch_by_batch(keeping, recording):
    """As off the recording; a sample whose temperature is not known is left out."""
    temperature = np.linspace(15, 25, 100)
    temperature[::10] = np.nan
    gappy = replace(recording.take(slice(100)), temperature_C=temperature)
    removal = EffectRemoval(keeping)
    parts = [removal.of(gappy.take(slice(first, first + 20))) for first in range(0, 100, 20)]
    known = gappy.take(np.isfinite(temperature))
    expected = keeping.readings_without_effects(known)
    assert_allclose(np.concatenate([part.readings_T for part in parts]), expected, rtol=1e-12)
    assert np.abs(expected - known.readings_T).max() > 3e-9


def test_an_effect_that_needs_later_samples_is_refused(plain):
    """One sentence names it and the remedy."""
    with pytest.raises(InputError, match=r"time_skew, which needs later samples.*use a calibration without it"):
        EffectRemoval(replace(plain, effects=(LATE,), effect_sizes=(SIZE,)))
