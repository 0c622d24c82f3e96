"""Jumps of a bias."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.bias_jump import BiasJump, gross_bias_jump
from tam_calibration.model.fitted_effect import SCALAR, FittedEffect
from tam_calibration.model.recording import Recording

EFFECT = BiasJump()
STEP = {"time_s": 31.42}
BOX = {"time_s": 31.42, "end_s": 40.07}


@pytest.mark.parametrize("shape", [STEP, BOX])
def test_coefficients_come_back(turning, refitted, shape):
    """Offsets of some axes and of the scalar are told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), shape, (0, 0, "offset"), (2, 1, "offset"), (SCALAR, None, "offset"))
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


def test_it_begins_and_ends_at_its_times(turning):
    """Before and after there is nothing."""
    covariates = turning()
    feature = EFFECT.terms(covariates, BOX)[0].features[:, 0]
    assert_allclose(feature, (covariates.time_s > 31.42) & (covariates.time_s < 40.07))


@pytest.mark.parametrize("where", [(1, 2), (SCALAR, None)])
@pytest.mark.parametrize("shape", [STEP, BOX])
def test_a_jump_of_one_row_is_found_to_the_sample(turning, left_by, where, shape):
    """Among the few shapes that are tried is the true one."""
    covariates = turning()
    residuals = left_by(EFFECT, covariates, shape, (*where, "offset", {"offset": 6e-9}))
    tried = EFFECT.shapes(covariates, residuals)
    assert len(tried) <= 8
    distance = [
        max(abs(other[name] - shape[name]) for name in shape) for other in tried if other.keys() == shape.keys()
    ]
    assert min(distance) <= 0.05


def test_a_magnet_that_all_sensors_see_is_found(turning, left_by):
    """Small jumps in many rows add up."""
    covariates = turning()
    offsets = 1.5e-9 * np.random.default_rng(3).choice([-1, 1], 12)
    jumps = [(*divmod(row, 3), "offset", {"offset": float(offset)}) for row, offset in enumerate(offsets)]
    tried = EFFECT.shapes(covariates, left_by(EFFECT, covariates, BOX, *jumps))
    pairs = [shape for shape in tried if "end_s" in shape]
    assert min(max(abs(pair[name] - BOX[name]) for name in BOX) for pair in pairs) <= 0.1


def test_a_sensor_of_its_own_can_jump(turning, left_by):
    """One sensor and a scalar are enough."""
    covariates = turning(sensors=1)
    tried = EFFECT.shapes(covariates, left_by(EFFECT, covariates, STEP, (0, 0, "offset", {"offset": 10e-9})))
    assert min(abs(shape["time_s"] - 31.42) for shape in tried) <= 0.2


def test_what_lags_behind_the_fastest_change_is_no_step(turning, left_by, slew):
    """An amplifier too slow for five samples of a run leaves no change for good or for a time."""
    covariates = turning()
    tried = list(EFFECT.shapes(covariates, left_by(slew, covariates, {}, (1, 0, "offset", {"offset": 1.0}))))
    fastest = covariates.time_s[np.argmax(np.abs(np.diff(covariates.sensed_T[:, 3])))]
    assert all(abs(time - fastest) > 0.5 for shape in tried for time in shape.values())


def test_few_samples_show_nothing(turning, left_by):
    """A jump needs a before and an after."""
    covariates = turning(samples=10)
    assert "too few" in EFFECT.obstacle(covariates)
    assert list(EFFECT.shapes(covariates, left_by(EFFECT, covariates, STEP))) == []


OFFSETS = 1e-6 * np.array([[-6.0, 1.0, 58.0], [3.0, 20.0, -5.0]])


def jumped(covariates, start, stop, size=1.0, noise_T=2e-9):
    """Return readings whose biases jump between two samples."""
    readings = covariates.errors.distort(covariates.field_T)
    readings[start:stop] += size * OFFSETS[: covariates.sensor_count]
    return Recording(covariates.time_s, readings + noise_T * np.random.default_rng(1).normal(size=readings.shape))


@pytest.mark.parametrize("sensors", [1, 2])
@pytest.mark.parametrize("stop", [900, 1200])
def test_times_and_offsets_are_found(turning, sensors, stop):
    """A jump for good, and one on and off, are found to some samples in spite of errors of scale."""
    covariates = turning(sensors=sensors)
    found = gross_bias_jump(jumped(covariates, 500, stop))
    assert_allclose(found.shape["time_s"], 24.975, atol=0.2)
    assert ("end_s" in found.shape) == (stop < 1200)
    if stop < 1200:
        assert_allclose(found.shape["end_s"], 44.975, atol=0.2)
    offsets = [contribution.values["offset"] for contribution in found.contributions]
    assert_allclose(offsets, OFFSETS[:sensors].ravel(), atol=3e-6)


def test_without_a_jump_there_is_none(turning):
    """Errors of scale and some outliers are no jump."""
    recording = jumped(turning(sensors=2), 0, 0)
    assert gross_bias_jump(recording) is None
    recording.readings_T[::97] += 20e-6
    assert gross_bias_jump(recording) is None


def test_short_records_tell_nothing(turning):
    """Two spheres need samples."""
    assert gross_bias_jump(jumped(turning(samples=60, sensors=1), 0, 0)) is None


def test_the_jump_of_gross_misfits_is_tried_first(turning, left_by):
    """What is too large for sums of small disturbances is looked for in the readings."""
    covariates = turning(sensors=1)
    shape = {"time_s": 24.975, "end_s": 44.975}
    offsets = [(0, axis, "offset", {"offset": float(offset)}) for axis, offset in enumerate(OFFSETS[0])]
    tried = BiasJump().shapes(covariates, left_by(BiasJump(), covariates, shape, *offsets))
    assert len(tried) <= 9
    assert_allclose(list(tried[0].values()), list(shape.values()), atol=0.2)


@pytest.mark.parametrize(("samples", "is_told"), [(60, False), (84, True)])
def test_a_sphere_lies_through_blocks_of_some_samples(turning, samples, is_told):
    """Three blocks tell a jump, two do not."""
    covariates = turning(samples=samples, step_s=60 / samples, sensors=1)
    assert (gross_bias_jump(jumped(covariates, samples // 2, samples)) is not None) == is_told


@pytest.mark.parametrize(("noise_T", "is_told"), [(3.5e-6, True), (6e-6, False)])
def test_a_jump_leaves_a_quarter_of_the_squares(turning, noise_T, is_told):
    """Six times less without noise and three times less with more of it: that may be one sphere."""
    recording = jumped(turning(sensors=1), 500, 1200, 0.5, noise_T)
    assert (gross_bias_jump(recording) is not None) == is_told


@pytest.mark.parametrize(("part", "is_gross"), [(0.075, False), (0.14, True)])
def test_a_jump_of_less_than_a_tenth_of_the_field_is_small(turning, part, is_gross):
    """However little noise there is."""
    covariates = turning(sensors=1)
    size = part * covariates.intensity_T[0] / np.linalg.norm(OFFSETS[0])
    assert (gross_bias_jump(jumped(covariates, 500, 1200, size)) is not None) == is_gross


@pytest.mark.parametrize(("part", "is_gross"), [(0.007, False), (0.014, True)])
def test_misfits_of_a_hundredth_of_the_field_are_gross(bench, monkeypatch, part, is_gross):
    """Below, sums of small disturbances find all jumps; above, the readings themselves are asked."""
    told = FittedEffect("bias_jump", {"time_s": -1.0}, ())
    monkeypatch.setattr("tam_calibration.effects.bias_jump.gross_bias_jump", lambda recording: told)
    residuals = bench().residuals()
    size = part * 50e-6 / np.sqrt(np.mean(residuals.row_shift_T**2))
    large = replace(residuals, differential=size * residuals.differential, common_mode=size * residuals.common_mode)
    assert (told.shape in BiasJump().shapes(residuals.covariates, large)) == is_gross
