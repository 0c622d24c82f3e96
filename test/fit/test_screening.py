"""Single bad readings are left out before a fit, and named; sound recordings lose none."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.fit import calibrate, screening
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.screening import without_bad_readings
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Tumble

SAMPLES = 1200


def run_of(scenario, seed=3, **changes):
    """Return a simulated recording of 1200 samples."""
    return simulate(replace(scenario, sample_count=SAMPLES, seed=seed, **changes)).recording


def changed(recording, chosen, sensor, change):
    """Return a recording whose readings (n, 3) of one sensor, in chosen samples, were changed."""
    readings_T = recording.readings_T.copy()
    readings_T[chosen, sensor] = change(readings_T[chosen, sensor])
    return replace(recording, readings_T=readings_T)


CHANGES = {
    "off": lambda readings: np.add(readings, [3e-6, -2.5e-6, 1.8e-6]),
    "shrunk": lambda readings: 0.6 * readings,
    "signs": lambda readings: readings * [1, -1, 1],
    "wraps": lambda readings: readings - 65.536e-6 * np.sign(readings) * [0, 0, 1],
    "far off": lambda readings: np.full_like(readings, -409.6e-6),
    "repeats": lambda readings: np.roll(readings, 1, axis=0),
}


def deviation_of(calibration, truth):
    """Return the root mean square error of the corrected field over the sphere, tesla, for readings without noise."""
    direction = np.random.default_rng(1).normal(size=(500, 3))
    field_T = 50e-6 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    unbiased = truth.distort(field_T) - calibration.errors.bias_T
    found_T = np.einsum("kij,nkj->nki", np.linalg.inv(calibration.errors.matrix), unbiased)
    return np.sqrt(((found_T - field_T[:, None]) ** 2).sum(axis=2).mean())


@pytest.mark.parametrize(
    ("kind", "part"),
    [*zip(CHANGES, [0.3, 0.1, 0.3, 0.1, 0.3, 0.1], strict=True), ("off", 0.001), ("repeats", 0.001)],
)
def test_bad_readings_of_a_sensor_are_found(wu_scenario, kind, part):
    """All of them, and nothing else, whatever they are, up to three tenths of the samples."""
    recording = run_of(wu_scenario)
    count = max(round(part * SAMPLES), 2)
    chosen = np.sort(np.random.default_rng(5).choice(SAMPLES, count, replace=False))
    bad = changed(recording, chosen, 1, CHANGES[kind])
    kept, found = without_bad_readings(bad, wu_scenario.array)
    differs = (bad.readings_T != recording.readings_T).any(axis=(1, 2))
    assert_array_equal(kept.time_s, recording.time_s[~differs])
    assert_array_equal(found.place, np.flatnonzero(differs))
    [sentence] = found.sentences()
    assert sentence.startswith(f"{count} of 1200 readings of sensor 2 contradict the others and are left out, first at")


def test_a_calibration_is_as_good_as_without_them(wu_scenario):
    """The field errs by less than 1.5 times as much, and a note says what was left out."""
    recording = run_of(wu_scenario)
    clean = calibrate(recording, wu_scenario.array)
    spoilt = calibrate(changed(recording, slice(0, None, 16), 1, CHANGES["off"]), wu_scenario.array)
    assert deviation_of(spoilt, wu_scenario.errors) < 1.5 * deviation_of(clean, wu_scenario.errors)
    assert clean.warnings == () and clean.samples == SAMPLES and spoilt.samples == SAMPLES - 75
    assert spoilt.warnings == () and spoilt.notes == (
        "75 of 1200 readings of sensor 2 contradict the others and are left out, every 16th between 0.00 and 1184.00 s",
    )


@pytest.mark.parametrize("value_T", [0.0, 20e-6, 1e3])
def test_a_value_that_a_sensor_repeats_for_a_second_is_left_out(wu_scenario, value_T):
    """On all its axes; a channel that holds for a tenth of the recording is another matter."""
    recording = run_of(wu_scenario)
    spoilt = calibrate(
        changed(recording, slice(300, 312), 2, lambda readings: readings * 0 + value_T), wu_scenario.array
    )
    assert spoilt.samples == SAMPLES - 12 and len(spoilt.notes) == 1
    with pytest.raises(Refused, match="sensor 3"):
        calibrate(changed(recording, slice(300, 430), 2, lambda readings: readings * 0 + value_T), wu_scenario.array)


def test_an_update_is_made_without_them(wu_scenario):
    """They are no change of the sensor since the prior, and a note names them."""
    before = calibrate(run_of(wu_scenario), wu_scenario.array)
    later = run_of(wu_scenario, seed=4)
    later = replace(later, time_s=later.time_s + 1e5)
    spoilt = calibrate(changed(later, slice(0, None, 40), 1, CHANGES["off"]), wu_scenario.array, prior=before)
    assert spoilt.samples == SAMPLES - 30 and spoilt.update.moved == ()
    assert spoilt.notes[0].startswith("30 of 1200 readings of sensor 2 contradict the others and are left out")


def test_bad_readings_that_pass_for_noise_are_found(wu_scenario):
    """Every tenth reading of a single sensor whose noise is not stated: the fit of all samples is smeared by them."""
    tumble = run_of(wu_scenario, motion=Tumble(np.radians(40)), rate_hz=10.0)
    alone = replace(tumble, readings_T=tumble.readings_T[:, :1])
    array, truth = Array(np.zeros((1, 3))), wu_scenario.errors
    truth = SensorErrors.from_vector(truth.to_vector()[:1], truth.orientation[:1])
    clean = deviation_of(calibrate(alone, array), truth)
    spoilt = calibrate(changed(alone, slice(0, None, 10), 0, lambda readings: readings * 0 - 32768e-9), array)
    assert deviation_of(spoilt, truth) < 1.5 * clean


def test_bad_readings_of_the_scalar_are_its_own(wu_scenario):
    """Zeros of the scalar are none of the sensors'."""
    recording = run_of(wu_scenario)
    scalar_T = recording.scalar_T.copy()
    scalar_T[[7, 300, 301]] = 0
    [sentence] = without_bad_readings(replace(recording, scalar_T=scalar_T), wu_scenario.array)[1].sentences()
    assert sentence == (
        "3 of 1200 readings of the scalar contradict the others and are left out, first at 7.00, 300.00, 301.00 s"
    )


KINDS = {
    "random attitudes": {},
    "a turn": {"motion": Tumble(np.radians(60)), "rate_hz": 10.0},
    "noise three times the stated": {"noise": 3.0},
    "a noise that is not stated": {"is_stated": False, "motion": Tumble(np.radians(60)), "rate_hz": 10.0},
    "one sensor": {"sensors": 1},
    "two sensors": {"sensors": 2},
    "no scalar": {"has_scalar": False},
    "a slow scalar": {"scalar_every": 10},
}


@pytest.mark.parametrize("kind", KINDS)
def test_sound_recordings_lose_nothing(wu_scenario, kind):
    """In none of 5 runs of each kind, where one in a thousand may."""
    asked = dict(KINDS[kind])
    noise, is_stated = asked.pop("noise", 1.0), asked.pop("is_stated", True)
    sensors, has_scalar = asked.pop("sensors", 4), asked.pop("has_scalar", True)
    every = asked.pop("scalar_every", 1)
    array = Array.cross(0.5, vector_noise_T=1e-9 / noise, scalar_noise_T=1e-10) if is_stated else Array.cross(0.5)
    if sensors < 4:
        array = Array(array.positions_m[:sensors], 1e-9, 1e-10)
    for seed in range(5):
        recording = run_of(wu_scenario, seed, **asked)
        has_reading = np.arange(SAMPLES) % every == 0
        scalar_T = np.where(has_reading, recording.scalar_T, np.nan) if has_scalar else None
        recording = replace(recording, readings_T=recording.readings_T[:, :sensors], scalar_T=scalar_T)
        assert without_bad_readings(recording, array) == (recording, None)


def test_a_magnet_that_is_brought_near_is_no_single_reading(wu_scenario):
    """It moves all sensors for a stretch of time: the checks of the fit tell it."""
    recording = run_of(wu_scenario)
    readings_T = recording.readings_T.copy()
    readings_T[300:500] += 2e-6
    recording = replace(recording, readings_T=readings_T)
    assert without_bad_readings(recording, wu_scenario.array) == (recording, None)


@pytest.mark.parametrize(
    ("chosen", "words"),
    [
        ([11], "1 of 1200 readings of sensor 2 contradicts the others and is left out, first at 11.00 s"),
        (slice(400, 520), "contradict the others and are left out, all between 400.00 and 519.00 s"),
        *(
            (slice(0, None, step), f"left out, every {step}{end} between 0.00 and")
            for step, end in ((4, "th"), (11, "th"), (21, "st"), (22, "nd"), (23, "rd"))
        ),
    ],
)
def test_when_they_come_is_told(wu_scenario, chosen, words):
    """One in the singular with its time, a burst by its first and last, and how often where they come evenly."""
    bad = changed(run_of(wu_scenario), chosen, 1, CHANGES["off"])
    [sentence] = without_bad_readings(bad, wu_scenario.array)[1].sentences()
    assert words in sentence


def test_a_spike_belongs_to_its_sensor_which_drifts_too(wu_scenario):
    """Its own limit is wider, and the spike moves the mean that the other sensors are compared with."""
    recording = run_of(wu_scenario)
    drift_T = 300e-9 * np.sin(np.arange(SAMPLES) / 50)[:, None]
    drifting = changed(recording, slice(None), 1, lambda readings: readings + drift_T)
    bad = changed(drifting, [100, 700], 1, lambda readings: readings + 30e-6)
    [sentence] = without_bad_readings(bad, wu_scenario.array)[1].sentences()
    assert sentence.startswith("2 of 1200 readings of sensor 2 contradict")


def test_where_no_majority_is_clear_nothing_is_left_out(wu_scenario):
    """A sensor that is off from the middle on is no few readings."""
    recording = changed(run_of(wu_scenario), slice(600, None), 2, CHANGES["off"])
    assert without_bad_readings(recording, wu_scenario.array) == (recording, None)


def test_few_samples_are_taken_as_they_are(wu_scenario):
    """Of 49 samples none is judged; of 50 it is."""
    recording = changed(run_of(wu_scenario), [5], 0, CHANGES["off"])
    assert without_bad_readings(recording.take(slice(49)), wu_scenario.array)[1] is None
    assert without_bad_readings(recording.take(slice(50)), wu_scenario.array)[1] is not None


def test_a_scalar_that_no_looked_at_sample_has_is_not_judged(wu_scenario, monkeypatch):
    """Of a large recording every n-th sample is looked at; a scalar of a tenth of the rate may be in none of them."""
    monkeypatch.setattr(screening, "SKETCH", 120)
    recording = run_of(wu_scenario)
    scalar_T = np.where(np.arange(SAMPLES) % 10 == 5, recording.scalar_T, np.nan)
    bad = changed(replace(recording, scalar_T=scalar_T), [7], 1, CHANGES["off"])
    [sentence] = without_bad_readings(bad, wu_scenario.array)[1].sentences()
    assert sentence.startswith("1 of 1200 readings of sensor 2 contradicts")


def test_robust_keeps_all_samples(wu_scenario):
    """It weighs them itself."""
    recording = changed(run_of(wu_scenario), slice(0, None, 16), 1, CHANGES["off"])
    assert calibrate(recording, wu_scenario.array, "robust").samples == SAMPLES
    assert calibrate(recording, wu_scenario.array, "lossless").samples == SAMPLES - 75
    assert maximum_likelihood(recording, wu_scenario.array).samples == SAMPLES
