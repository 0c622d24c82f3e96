"""One sensor against the others."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.single_samples import AgainstOthers, InterpolatedSamples, StaleSamples


def before_calibration(residuals, sensor):
    """Return what a sensor reads beyond the others, and what it should read, beside the calibration that is known."""
    against = AgainstOthers(residuals, sensor)
    return against.beyond_T + against.calibration_T, against.expected_T - against.calibration_T


def test_a_shift_is_told_of_the_sensor_that_has_it(bench):
    """What one sensor reads beyond the others is its own shift, to the noise of both; what it should read is not."""
    made = bench()
    before, expected_before = before_calibration(made.residuals(), 1)
    rows, shift = made.rows_T.copy(), np.array([40e-9, -70e-9, 20e-9])
    rows[700:800, 3:6] += shift
    after, expected = before_calibration(made.with_rows(rows).residuals(), 1)
    assert_allclose(after[700:800] - before[700:800], np.tile(shift, (100, 1)), atol=1e-13)
    assert_allclose(expected, expected_before, rtol=0, atol=1e-13)
    own = made.covariates.sensed_T[:, 3:6]
    assert np.abs(expected - own).max() < 5e-9 and np.std(expected - own) < 0.7e-9


def test_the_energy_of_noise_is_one_for_each_axis(bench):
    """The noise of the others counts."""
    for sensors in (2, 4):
        residuals = bench(4000, sensors).residuals()
        beyond, _ = before_calibration(residuals, 0)
        assert_allclose(AgainstOthers(residuals, 0).energy(beyond).mean(), 3, rtol=0.06)


def test_a_minority_does_not_tilt_the_calibration(bench):
    """With two fifths of the samples far off, and a wrong matrix and bias, the others are left with noise alone."""
    made = bench()
    rows, off = made.rows_T.copy(), np.random.default_rng(3).random(2000) < 0.4
    rows[:, 3:6] = rows[:, 3:6] @ (np.eye(3) + 1e-3 * np.arange(9).reshape(3, 3)) + 50e-9
    rows[off, 3:6] += 0.02 * made.covariates.sensed_T[off, 6:9] + 300e-9
    residuals = made.with_rows(rows).residuals()
    against = AgainstOthers(residuals, 1)
    assert np.median(against.energy(before_calibration(residuals, 1)[0])[~off]) > 100
    assert_allclose(np.mean(_energy(against)[~off]), 3, rtol=0.15)
    without = replace(residuals, channel_count=residuals.channel_count * ~off)
    assert_allclose(np.mean(_energy(AgainstOthers(without, 1))[~off]), 3, rtol=0.15)


def _energy(against):
    return against.energy(against.beyond_T)


@pytest.mark.parametrize("effect", [InterpolatedSamples(), StaleSamples()], ids=lambda effect: effect.name)
def test_one_other_sensor_is_enough(bench, effect):
    """None is too few."""
    assert effect.obstacle(bench(60, 1).covariates) is not None
    assert effect.obstacle(bench(60, 2).covariates) is None
