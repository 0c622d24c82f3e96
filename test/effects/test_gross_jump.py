"""Jumps of a bias that no calibration fits."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.states import gross_bias_jump
from tam_calibration.model.recording import Recording

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
