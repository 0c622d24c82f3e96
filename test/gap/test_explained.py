"""A doubt about a residual names the cause that a diagnosis finds."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit import calibrate
from tam_calibration.fit.consistency import is_unexplained
from tam_calibration.gap.explained import explained
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


@pytest.fixture(scope="module")
def made():
    """Return a turning array and its recording."""
    return simulate(replace(read_scenario("tumble_100_hz"), sample_count=750, rate_hz=50.0))


def reasons_of(made, readings_T):
    """Return the reasons to doubt a calibration of readings, with their causes."""
    recording, array = replace(made.recording, readings_T=readings_T), made.scenario.array
    calibration = calibrate(recording, array)
    assert is_unexplained(calibration)
    return explained(calibration, recording, array).quality


def test_a_tone_is_named_with_the_command_that_takes_it_off(made):
    """The effect, the sensor, and what to do."""
    readings_T = made.recording.readings_T.copy()
    readings_T[:, 1, 0] += 20e-9 * np.sin(2 * np.pi * 7.3 * made.recording.time_s)
    quality = reasons_of(made, readings_T)
    assert quality.grade == "doubtful" and "periodic interference in sensor 2 explains it" in quality.reasons[0]
    assert quality.next[0] == "fit that too, with --effects periodic_interference"


def test_noise_that_was_stated_too_small_is_told_with_its_size(made):
    """It is no effect: the array file should state it."""
    noise_T = 2e-9 * np.random.default_rng(2).normal(size=made.recording.readings_T.shape)
    quality = reasons_of(made, made.recording.readings_T + noise_T)
    assert "white noise of 2.1" in quality.reasons[0] and quality.next[0] == "state that noise in the array file"


def test_what_no_effect_explains_is_said(made):
    """A slow course that no channel has."""
    time_s = made.recording.time_s - made.recording.time_s[0]
    course = np.sin(2 * np.pi * time_s / 7.0) * np.sign(np.sin(2 * np.pi * time_s / 3.1))
    readings_T = made.recording.readings_T.copy()
    readings_T[:, 2, 1] += 30e-9 * course
    quality = reasons_of(made, readings_T)
    assert quality.grade == "doubtful" and "explains" in quality.reasons[0] and "tam diagnose" not in quality.next
