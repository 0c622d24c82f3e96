"""Gains of two states."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.effects.recursions import Memory
from tam_calibration.effects.states import GainSwitching
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

EFFECT = GainSwitching()
THRESHOLDS = {"upper_T": 35e-6, "lower_T": 28e-6}
OF_SENSOR = {"sensor_upper_T": 45e-6, "sensor_lower_T": 38e-6}


def changes_of(covariates, shape, where):
    """Return the times between the samples at which the gain of a row changes."""
    values = {"gain": 1.0}
    fitted = FittedEffect("gain_switching", shape, (Contribution(*where, "gain", values),))
    on = EFFECT.signal(covariates, fitted)[:, 3 * where[0] + where[1]] != 0
    flips = np.flatnonzero(np.diff(on)) + 1
    return ((covariates.time_s[flips - 1] + covariates.time_s[flips]) / 2).tolist()


@pytest.mark.parametrize("shape", [THRESHOLDS, OF_SENSOR])
def test_the_thresholds_that_make_the_times_are_offered(turning, shape):
    """Those of the axis whose reading switches the gain, or of the largest of its sensor, beside the windows."""
    covariates = turning()
    windows, *others = EFFECT.shapes_at(changes_of(covariates, shape, (1, 2)), covariates)
    assert "on_2_s" in windows
    distance = [max(abs(one[name] - shape[name]) for name in shape) for one in others if one.keys() == shape.keys()]
    assert min(distance) < 1e-6


def test_a_gain_that_changes_twice_is_a_step(turning):
    """Three changes are the fewest of one that goes to and fro; times at random have no thresholds."""
    covariates = turning()
    assert EFFECT.shapes_at([10.0, 20.0], covariates) == []
    assert EFFECT.shapes_at([10.0, 20.0, 30.0], covariates)[0] == {"on_1_s": 10.0, "off_1_s": 20.0, "on_2_s": 30.0}
    assert len(EFFECT.shapes_at(np.sort(np.random.default_rng(1).uniform(0, 60, 20)), covariates)) == 1


def test_thresholds_have_hysteresis_and_remember(turning):
    """Between the thresholds the gain stays what it was, across batches too."""
    covariates = turning()
    fitted = FittedEffect("gain_switching", THRESHOLDS, (Contribution(0, 2, "gain", {"gain": 1.0}),))
    whole = EFFECT.signal(covariates, fitted)[:, 2]
    reading = np.abs(covariates.sensed_T[:, 2] + covariates.errors.bias_T[0, 2])
    state, expected = False, []
    for one in reading:
        state = one > 35e-6 or (state and one >= 28e-6)
        expected.append(state)
    assert_array_equal(whole != 0, expected)
    assert 100 < sum(expected) < 1100
    memory = Memory()
    parts = []
    for start in range(0, 1200, 37):
        memory.rewind()
        part = replace(covariates.take(slice(start, start + 37)), memory=memory)
        parts.append(EFFECT.signal(part, fitted)[:, 2])
    assert_allclose(np.concatenate(parts), whole)
