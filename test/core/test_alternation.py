"""Two publishers on one topic are found where their readings come in turn; sound sensors are not."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.core.alternation import alternations
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


@pytest.fixture(scope="module")
def turning():
    """Return the recording of an array that turns at 100 Hz."""
    return simulate(replace(read_scenario("tumble_100_hz"), sample_count=1000)).recording


def test_two_publishers_in_turn_are_found(turning):
    """The sensor is named with the distance of the courses, where messages of another come between its own."""
    readings_T = turning.readings_T.copy()
    readings_T[1::2, 1] = turning.readings_T[1::2, 3]
    [(sensor, words)] = alternations(readings_T).items()
    assert sensor == 2 and "sensor 2 alternate" in words and "two publishers" in words


def stepped(readings_T):
    """Return readings in coarse steps."""
    return 150e-9 * np.round(readings_T / 150e-9)


def held(readings_T):
    """Return readings of which sensor 3 repeats each once."""
    changed = readings_T.copy()
    changed[1::2, 2] = changed[::2, 2]
    return changed


def noisy(readings_T):
    """Return readings of which sensor 1 has much more noise than the motion."""
    changed = readings_T.copy()
    changed[:, 0] += 20e-6 * np.random.default_rng(1).normal(size=changed[:, 0].shape)
    return changed


@pytest.mark.parametrize("change", [np.copy, stepped, held, noisy])
def test_sound_sensors_do_not_alternate(turning, change):
    """Smooth, coarse, slow and noisy ones."""
    assert alternations(change(turning.readings_T)) == {}


def test_an_array_that_is_turned_to_and_fro_does_not(wu_run):
    """All sensors alternate then; neither do random attitudes."""
    readings_T = wu_run.recording.readings_T.copy()
    assert alternations(wu_run.recording.readings_T) == {}
    readings_T[2::2], readings_T[1::2] = readings_T[0], readings_T[1]
    readings_T += 1e-9 * np.random.default_rng(2).normal(size=readings_T.shape)
    assert alternations(readings_T) == {}
