"""Noise that exceeds that of the other rows: whose it is and how large, and what is no noise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.noise_excess import NoiseExcess
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution

EXCESS = NoiseExcess()


def noise(sensor, axis=None, size=1e-9):
    """Return what the effect does at one place."""
    return Contribution(sensor, axis, "noise", {"standard deviation": size})


def test_noise_of_all_sensors_beyond_a_wrong_data_sheet(bench):
    """One and a half times the noise stated is told of all sensors, with its size within its error."""
    made = bench(2000, 4, seed=1, sheet=1.5)
    (part,) = EXCESS.find(made.residuals()).fitted.contributions
    assert (part.sensor, part.axis) == (ALL, None)
    stated = np.sqrt(np.mean(made.residuals().covariates.array.vector_noise_T ** 2))
    value, error = part.values["standard deviation"], part.standard_errors["standard deviation"]
    assert abs(value - stated * np.sqrt(1.5**2 - 1)) < 3.5 * error


@pytest.mark.parametrize(("sensor", "axis"), [(1, 2), (3, None), (SCALAR, None)])
@pytest.mark.parametrize("moves", [True, False])
def test_the_noisy_row_is_found(bench, sensor, axis, moves):
    """Place and size come out within their standard errors, on a floor that is not the data sheet's."""
    size = 0.6e-9 if sensor == SCALAR else 1e-9
    made = bench(moves=moves, sheet=1.1).with_effect(EXCESS, noise(sensor, axis, size))
    residuals = made.residuals()
    found = EXCESS.find(residuals)
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis) == (sensor, axis)
    value, error = part.values["standard deviation"], part.standard_errors["standard deviation"]
    assert abs(value - size) < 3.5 * error and 0 < error < 0.1 * size
    assert found.gain - found.parameter_count * np.log(residuals.channel_count.sum()) > 50
    rows = {SCALAR: [12], 1: [5], 3: [9, 10, 11]}[sensor]
    assert_allclose(found.variance[rows], value**2, rtol=1e-6)
    assert not np.delete(found.variance, rows).any()


def test_the_gain_is_that_of_the_likelihood(bench):
    """Twice the log likelihood ratio against one free variance, as full covariance matrices give it."""
    made = bench(300, has_scalar=False).with_effect(EXCESS, noise(1, 2, 1.5e-9))
    residuals = made.residuals()
    found = EXCESS.find(residuals)
    own = found.variance[5]

    shift = np.column_stack([np.tile(residuals.directions[5], (300, 1)), residuals.row_slope[:, 5]])
    residual = np.column_stack([residuals.differential, residuals.common_mode])

    def deviance(floor, variance):
        covariance = floor * np.eye(10) + variance * shift[:, :, None] * shift[:, None]
        solved = np.linalg.solve(covariance, residual[:, :, None])[:, :, 0]
        return np.linalg.slogdet(covariance)[1].sum() + np.sum(residual * solved)

    from scipy.optimize import minimize_scalar

    without = minimize_scalar(lambda floor: deviance(floor, 0.0), bounds=(0.5, 3.0), method="bounded").fun
    beside = minimize_scalar(lambda floor: deviance(floor, own), bounds=(0.5, 3.0), method="bounded").fun
    assert_allclose(found.gain, without - beside, rtol=0.01)


@pytest.mark.parametrize("slope", [0.3, 0.7])
def test_coloured_noise_counts(bench, slope):
    """1/f noise of one axis is an excess, too; so is noise that comes and goes."""
    made = bench()
    spectrum = np.fft.rfft(np.random.default_rng(3).normal(0, 2e-9, 2000))
    spectrum[1:] *= (np.arange(1, len(spectrum)) / len(spectrum)) ** (-slope / 2)
    rows = made.rows_T.copy()
    rows[:, 4] += np.fft.irfft(spectrum, 2000)
    (part,) = EXCESS.find(made.with_rows(rows).residuals()).fitted.contributions
    assert (part.sensor, part.axis) == (1, 1)


def test_noise_for_a_while_counts(bench):
    """An axis that is loud in a third of the record has excess noise."""
    made = bench()
    rows = made.rows_T.copy()
    rows[500:1200, 4] += np.random.default_rng(3).normal(0, 3e-9, 700)
    (part,) = EXCESS.find(made.with_rows(rows).residuals()).fitted.contributions
    assert (part.sensor, part.axis) == (1, 1)


def test_spikes_are_no_noise(bench):
    """Few large readings are left to outliers."""
    made = bench()
    rows = made.rows_T.copy()
    rows[::100, 4] += 30e-9
    assert isinstance(EXCESS.find(made.with_rows(rows).residuals()), str)


def test_too_few_samples_are_told(bench):
    """Twenty samples tell no variance."""
    assert "24 samples" in EXCESS.find(bench(20).residuals())


def test_added_noise_has_the_stated_size(bench):
    """In simulations every axis of the sensor has noise of its own."""
    made = bench(20_000)
    change = made.with_effect(EXCESS, noise(2, None, 3e-9)).rows_T - made.rows_T
    assert_allclose(change[:, 6:9].std(axis=0), 3e-9, rtol=0.02)
    assert np.abs(np.corrcoef(change[:, 6:9].T) - np.eye(3)).max() < 0.03
    assert not change[:, [0, 1, 2, 3, 4, 5, 9, 10, 11, 12]].any()


def excess(made, row, variance_T2):
    """Return what is found of so much in one row."""
    rows = made.rows_T.copy()
    rows[:, row] += np.random.default_rng(3).normal(0, np.sqrt(variance_T2), len(rows))
    return EXCESS.find(made.with_rows(rows).residuals())


@pytest.mark.parametrize(("part", "is_told"), [(0.08, False), (0.13, True)])
def test_axes_of_a_kind_differ_by_a_tenth(bench, part, is_told):
    """An axis with eight per cent more variance than stated is none that is noisier, one with thirteen is."""
    assert isinstance(excess(bench(20_000), 4, part * 1e-18), str) != is_told


@pytest.mark.parametrize(("part", "is_told"), [(0.8, False), (1.4, True)])
def test_a_scalar_may_have_nearly_half_more(bench, part, is_told):
    """Its data sheet may err by a fifth, and that of the sensors by as much the other way."""
    assert isinstance(excess(bench(4000, noise_T=1e-10), 12, part * 1e-20), str) != is_told


def test_forty_samples_tell_a_variance(bench):
    """They are not too few."""
    assert "samples or more" not in EXCESS.find(bench(42).residuals())
