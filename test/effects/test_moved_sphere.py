"""Jumps of a bias as large as the field."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.bias_jump import BiasJump
from tam_calibration.effects.fitted import FittedEffect
from tam_calibration.effects.moved_sphere import moved_sphere
from tam_calibration.recording import Recording

OFFSETS = 1e-6 * np.array([[-6.0, 1.0, 58.0], [3.0, 20.0, -5.0]])


def jumped(situation, start, stop, size=1.0, noise_T=2e-9):
    """Return readings whose biases jump between two samples."""
    readings = situation.errors.distort(situation.field_T)
    readings[start:stop] += size * OFFSETS[: situation.sensor_count]
    return Recording(situation.time_s, readings + noise_T * np.random.default_rng(1).normal(size=readings.shape))


@pytest.mark.parametrize("sensors", [1, 2])
@pytest.mark.parametrize("stop", [900, 1200])
def test_times_and_offsets_are_found(turning, sensors, stop):
    """A jump for good, and one on and off, are found to some samples in spite of errors of scale."""
    situation = turning(sensors=sensors)
    found = moved_sphere(jumped(situation, 500, stop))
    assert_allclose(found.shape["time_s"], 24.975, atol=0.2)
    assert ("end_s" in found.shape) == (stop < 1200)
    if stop < 1200:
        assert_allclose(found.shape["end_s"], 44.975, atol=0.2)
    offsets = [contribution.values["offset"] for contribution in found.contributions]
    assert_allclose(offsets, OFFSETS[:sensors].ravel(), atol=3e-6)


def test_without_a_jump_there_is_none(turning):
    """Errors of scale and some outliers are no jump."""
    recording = jumped(turning(sensors=2), 0, 0)
    assert moved_sphere(recording) is None
    recording.readings_T[::97] += 20e-6
    assert moved_sphere(recording) is None


def test_short_records_tell_nothing(turning):
    """Two spheres need samples."""
    assert moved_sphere(jumped(turning(samples=60, sensors=1), 0, 0)) is None


def test_the_jump_of_gross_misfits_is_tried_first(turning, left_by):
    """What is too large for sums of small disturbances is looked for in the readings."""
    situation = turning(sensors=1)
    shape = {"time_s": 24.975, "end_s": 44.975}
    offsets = [(0, axis, "offset", {"offset": float(offset)}) for axis, offset in enumerate(OFFSETS[0])]
    tried = BiasJump().shapes(situation, left_by(BiasJump(), situation, shape, *offsets))
    assert len(tried) <= 9
    assert_allclose(list(tried[0].values()), list(shape.values()), atol=0.2)


@pytest.mark.parametrize(("samples", "is_told"), [(60, False), (84, True)])
def test_a_sphere_lies_through_blocks_of_some_samples(turning, samples, is_told):
    """Three blocks tell a jump, two do not."""
    situation = turning(samples=samples, step_s=60 / samples, sensors=1)
    assert (moved_sphere(jumped(situation, samples // 2, samples)) is not None) == is_told


@pytest.mark.parametrize(("noise_T", "is_told"), [(3.5e-6, True), (6e-6, False)])
def test_a_jump_leaves_a_quarter_of_the_squares(turning, noise_T, is_told):
    """Six times less without noise and three times less with more of it: that may be one sphere."""
    recording = jumped(turning(sensors=1), 500, 1200, 0.5, noise_T)
    assert (moved_sphere(recording) is not None) == is_told


@pytest.mark.parametrize(("part", "is_gross"), [(0.075, False), (0.14, True)])
def test_a_jump_of_less_than_a_tenth_of_the_field_is_small(turning, part, is_gross):
    """However little noise there is."""
    situation = turning(sensors=1)
    size = part * situation.intensity_T[0] / np.linalg.norm(OFFSETS[0])
    assert (moved_sphere(jumped(situation, 500, 1200, size)) is not None) == is_gross


@pytest.mark.parametrize(("part", "is_gross"), [(0.007, False), (0.014, True)])
def test_misfits_of_a_hundredth_of_the_field_are_gross(bench, monkeypatch, part, is_gross):
    """Below, sums of small disturbances find all jumps; above, the readings themselves are asked."""
    told = FittedEffect("bias_jump", {"time_s": -1.0}, ())
    monkeypatch.setattr("tam_calibration.effects.bias_jump.moved_sphere", lambda recording: told)
    misfit = bench().misfit()
    size = part * 50e-6 / np.sqrt(np.mean(misfit.row_shift_T**2))
    large = replace(misfit, differential=size * misfit.differential, common_mode=size * misfit.common_mode)
    assert (told.shape in BiasJump().shapes(misfit.situation, large)) == is_gross
