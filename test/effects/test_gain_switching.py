"""Gains of two states."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.effects.covariates import Memory
from tam_calibration.effects.gain_switching import GainSwitching
from tam_calibration.files.schema import check
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

EFFECT = GainSwitching()
WINDOWS = {"on_1_s": 5.02, "off_1_s": 8.02, "on_2_s": 21.52, "off_2_s": 25.02, "on_3_s": 50.02}
THRESHOLDS = {"upper_T": 35e-6, "lower_T": 28e-6}
OF_SENSOR = {"sensor_upper_T": 45e-6, "sensor_lower_T": 38e-6}


@pytest.mark.parametrize("shape", [WINDOWS, THRESHOLDS, OF_SENSOR])
def test_coefficients_come_back(turning, refitted, shape):
    """Gains of some axes are told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), shape, (0, 0, "gain"), (2, 1, "gain"))
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


@pytest.mark.parametrize("shape", [WINDOWS, THRESHOLDS])
def test_the_states_of_an_axis_are_found(turning, left_by, shape):
    """Windows are windows, and a gain that the reading itself switches has its thresholds."""
    covariates = turning()
    residuals = left_by(EFFECT, covariates, shape, (1, 2, "gain", {"gain": 3e-4}))
    (found,) = EFFECT.shapes(covariates, residuals)
    assert found.keys() == shape.keys()
    within = 0.3 if shape is WINDOWS else 1.5e-6
    assert max(abs(found[name] - shape[name]) for name in shape) < within


def test_the_thresholds_of_a_sensor_are_found(turning, left_by):
    """The largest axis may switch all three."""
    covariates = turning()
    parts = [(1, axis, "gain", {"gain": 3e-4}) for axis in range(3)]
    (found,) = EFFECT.shapes(covariates, left_by(EFFECT, covariates, OF_SENSOR, *parts))
    assert max(abs(found[name] - OF_SENSOR[name]) for name in OF_SENSOR) < 1.5e-6


@pytest.mark.parametrize(
    "course",
    [
        lambda covariates: 0.0 * covariates.time_s,
        lambda covariates: 1e-4 * (covariates.time_s > 30) * covariates.sensed_T[:, 4],
        lambda covariates: 3e-4 * np.sin(covariates.time_s / 4) * covariates.sensed_T[:, 4],
        lambda covariates: 2e-8 * (covariates.sensed_T[:, 4] / 5e-5) ** 3,
    ],
    ids=["noise", "a single step", "a slow swing", "a curve"],
)
def test_other_courses_are_no_switching(turning, left_by, course):
    """Chance, one step, a smooth drift of the scale and a curve offer no windows."""

    class Other:
        name = "other"

        def add(self, rows_T, covariates, fitted, generator):
            rows = rows_T.copy()
            rows[:, 4] += course(covariates)
            return rows

    covariates = turning()
    assert list(EFFECT.shapes(covariates, left_by(Other(), covariates, {}))) == []


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


def test_few_samples_show_nothing(turning, left_by):
    """Windows need some samples."""
    covariates = turning(samples=10)
    assert "too few" in EFFECT.obstacle(covariates)
    assert list(EFFECT.shapes(covariates, left_by(EFFECT, covariates, WINDOWS))) == []


@pytest.mark.parametrize("shape", [WINDOWS, THRESHOLDS, OF_SENSOR])
def test_it_survives_a_file(shape):
    """Windows and thresholds read again from what is written are the same."""
    fitted = FittedEffect("gain_switching", shape, (Contribution(1, 2, "gain", {"gain": 2e-4}),))
    units = dict(EFFECT.shape_units) | {"gain": "1"}
    assert check(effect_to_mapping(fitted, units), EffectFile).to_fitted() == fitted
