"""Bias and scale factor that drift with temperature."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from tam_calibration.effects.courses import TemperatureDrift

SHAPE = {"time_constant_s": 4.0, "inner_share": 0.3, "reference_C": 20.0, "start_s": 0.0}
EFFECT = TemperatureDrift()


def test_heat_passes_both_layers(turning):
    """The change is that of two first-order lags in a row, by a library's integration, to the square of a step."""
    covariates = turning()
    outer_s, inner_s = 2.8, 1.2

    def rate(time, state):
        outside = np.interp(time, covariates.time_s, covariates.temperature_C)
        return [(outside - state[0]) / outer_s, (state[0] - state[1]) / inner_s]

    start = [covariates.temperature_C[0]] * 2
    span = (covariates.time_s[0], covariates.time_s[-1])
    inside = solve_ivp(rate, span, start, t_eval=covariates.time_s, rtol=1e-8, max_step=0.05).y[1]
    offset = next(term for term in EFFECT.terms(covariates, SHAPE) if term.name == "offset")
    assert_allclose(offset.features[:, 0], inside - SHAPE["reference_C"], atol=3e-4)


def test_a_start_that_was_not_settled_is_told_from_the_drift(turning, refitted):
    """What the sensor still felt of the time before the record dies away, and is nothing before its start."""
    covariates = turning()
    deviation, _ = refitted(EFFECT, covariates, SHAPE, (0, 1, "offset"), (0, 1, "start"))
    assert np.abs(deviation).max() < 4
    later = replace(covariates, time_s=covariates.time_s - 1e6)
    terms = [term for term in EFFECT.terms(later, SHAPE) if term.name == "start"]
    assert terms and all(not term.features.any() for term in terms)


def test_a_sensor_without_lag_settles_at_once(turning):
    """A search that ends at no lag at all divides by nothing: the start is felt by the first sample alone."""
    covariates = turning(samples=50)
    shape = SHAPE | {"time_constant_s": 0.0, "start_s": float(covariates.time_s[0])}
    for term in EFFECT.terms(covariates, shape):
        if term.name == "start":
            assert term.features[0] == 1 and not term.features[1:].any()


def test_the_reference_temperature_adds_nothing(turning):
    """At its reference temperature a sensor reads as calibrated."""
    covariates = turning(samples=50)
    at_rest = replace(covariates, temperature_C=np.full(50, SHAPE["reference_C"]))
    assert all(not term.features.any() for term in EFFECT.terms(at_rest, SHAPE) if term.name != "start")


def test_a_constant_temperature_shows_nothing(turning):
    """Some hundredths of a kelvin are no change."""
    covariates = turning()
    steady = 20 + 0.02 * np.random.default_rng(1).normal(size=covariates.sample_count)
    assert EFFECT.obstacle(covariates) is None
    assert "changes by 0.0" in EFFECT.obstacle(replace(covariates, temperature_C=steady))


def test_lags_reach_from_none_to_a_third_of_the_record(turning, left_by):
    """Few are tried, with one reference."""
    covariates = turning()
    shapes = EFFECT.shapes(covariates, left_by(EFFECT, covariates, SHAPE))
    constants = [shape["time_constant_s"] for shape in shapes]
    assert constants[0] == 0
    assert_allclose(constants[-1], 0.05 * 1199 / 3)
    assert len(constants) <= 12
    assert {shape["reference_C"] for shape in shapes} == {float(np.mean(covariates.temperature_C))}


@pytest.mark.parametrize(("change_K", "is_enough"), [(0.14, False), (0.28, True)])
def test_the_temperature_must_change_by_more_than_thermometers_err(turning, change_K, is_enough):
    """By a fifth of a kelvin."""
    covariates = turning()
    temperature = 20 + change_K * (covariates.time_s > 30)
    assert (EFFECT.obstacle(replace(covariates, temperature_C=temperature)) is None) == is_enough
