"""Times of sampling that scatter at random."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import minimize_scalar

from tam_calibration.effects.noise_excess import TimingJitter
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

JITTER = TimingJitter()


def displaced(made, delay_s):
    """Return the bench whose third sensor is sampled late by each sample's own delay, to first order."""
    rows = made.rows_T.copy()
    rows[:, 6:9] -= delay_s[:, None] * np.gradient(made.covariates.sensed_T[:, 6:9], made.covariates.step_s, axis=0)
    return made.with_rows(rows)


def white(size_s, seed=5):
    """Return delays that scatter at random."""
    return np.random.default_rng(seed).normal(0, size_s, 2000)


@pytest.mark.parametrize("size_s", [3e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("sheet", [0.9, 1.1])
@pytest.mark.parametrize("sensors", [2, 4])
def test_jitter_is_found(bench, size_s, sheet, sensors):
    """The sensor and its size come out, within the standard error, on a floor that is not the data sheet's."""
    made = displaced(bench(sensors=sensors + 1, sheet=sheet), white(size_s))
    found = JITTER.find(made.residuals())
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis, part.term) == (2, None, "jitter")
    value, error = part.values["standard deviation"], part.standard_errors["standard deviation"]
    assert abs(value - size_s) < 3.5 * error < 0.35 * size_s
    assert found.gain > 60 and found.flagged is None


def test_the_gain_is_that_of_the_likelihood(bench):
    """Twice the log likelihood ratio against one free variance, as full covariance matrices give it."""
    residuals = displaced(bench(), white(1e-4)).residuals()
    found = JITTER.find(residuals)
    common = np.sum(residuals.row_slope * found.spread_T, axis=1)
    along = np.column_stack([found.spread_T[:, :-1] @ residuals.directions, common])
    residual = np.column_stack([residuals.differential, residuals.common_mode])

    def deviance(floor, is_on):
        covariance = floor * np.eye(10) + is_on * along[:, :, None] * along[:, None, :]
        solved = np.linalg.solve(covariance, residual[:, :, None])[:, :, 0]
        return np.linalg.slogdet(covariance)[1].sum() + np.sum(residual * solved)

    without, beside = (
        minimize_scalar(deviance, bounds=(0.5, 9), args=(is_on,), method="bounded").fun for is_on in (0, 1)
    )
    assert_allclose(found.gain, without - beside, rtol=0.02)


def test_it_takes_motion_and_another_sensor(bench):
    """Poses have no rate, and one sensor alone does not tell the rate at its own time."""
    assert "jumps" in JITTER.obstacle(bench(moves=False).covariates)
    assert "one sensor alone" in JITTER.obstacle(bench(sensors=1).covariates)
    assert JITTER.obstacle(bench().covariates) is None


def test_more_than_a_tenth_of_a_second_is_no_jitter(turning):
    """That is as long as a system holds up a process; 80 ms may be, 120 ms may not."""
    for size, is_too_large in ((0.08, False), (0.12, True)):
        part = Contribution(0, None, "jitter", {"standard deviation": size})
        assert JITTER.is_natural(turning(), FittedEffect("timing_jitter", {}, (part,))) != is_too_large


def test_the_twin_shows_what_was_found(bench):
    """Its size is found again."""
    made = bench(8000).with_effect(JITTER, Contribution(1, None, "jitter", {"standard deviation": 2e-4}))
    (part,) = JITTER.find(made.residuals()).fitted.contributions
    assert part.sensor == 1
    assert_allclose(part.values["standard deviation"], 2e-4, rtol=0.05)


def test_its_size_and_the_sensor_are_paid_for(bench):
    """Two numbers, whatever the rest."""
    assert JITTER.find(displaced(bench(), white(1e-4)).residuals()).parameter_count == 2
