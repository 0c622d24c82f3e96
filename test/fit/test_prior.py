"""A calibration as prior: widened by time and temperature, in its own frame and scale, or refused."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import in_first_frame, prior_of
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration with a date and a temperature."""
    return replace(maximum_likelihood(recording, cross), temperature_C=10.0)


def test_the_prior_is_the_calibration_widened(calibration):
    """Variances of time and temperature are added to those of the calibration."""
    end_s, rates = calibration.time_span_s[1], ChangeRates()
    prior = prior_of(calibration, end_s + 2 * DAY_S, 13.0, rates)
    assert prior.elapsed_s == pytest.approx(2 * DAY_S)
    assert prior.warming_K == pytest.approx(3.0)
    added = (prior.standard_errors**2 - calibration.standard_errors**2)[1]
    assert_allclose(added[:9], rates.variances(2 * DAY_S, 3.0)[:9], rtol=1e-6)


def test_a_turn_of_sensor_1_turns_the_others_in_its_frame(calibration):
    """The misalignment of sensor 1 stays zero; those of the others change by both, and together."""
    rates = ChangeRates()
    prior = prior_of(calibration, calibration.time_span_s[1] + DAY_S, None, rates)
    added = (prior.covariance - calibration.covariance)[21:48, 21:48]
    one = rates.variances(DAY_S, 0.0)[9]
    assert not prior.covariance[9:12].any()
    assert_allclose(np.diag(added)[:3], 2 * one, rtol=0.02)
    assert_allclose([added[0, 12], added[1, 13], added[2, 14]], one, rtol=0.02)


def test_without_dates_a_day_has_passed(calibration):
    """Stamps that count from the start of a recording, and temperatures that nobody read, are said to be unknown."""
    undated = replace(calibration, time_span_s=(0.0, 6.0))
    for each, time_s in ((undated, 1.7e9), (calibration, 12.0), (calibration, None)):
        prior = prior_of(each, time_s, None)
        assert prior.elapsed_s is None and prior.warming_K is None
        expected = prior_of(calibration, calibration.time_span_s[1] + DAY_S, None)
        assert_allclose(prior.covariance, expected.covariance)


def test_the_derivative_into_the_frame_of_sensor_1(true_errors):
    """That of the difference quotient, sensor 1 turned by degrees and the others beside it."""
    vector = true_errors.to_vector()
    vector[0, 9:] = [0.03, -0.05, 0.02]
    turned, derivative = in_first_frame(SensorErrors.from_vector(vector))
    assert not turned.misalignment[0].any()
    step = np.random.default_rng(2).normal(size=vector.shape) * np.tile(np.repeat([1e-6, 1e-6, 1e-9, 1e-6], 3), (4, 1))
    ends = [in_first_frame(SensorErrors.from_vector(vector + sign * step))[0].to_vector() for sign in (1, -1)]
    assert_allclose((derivative @ step.ravel()).reshape(4, 12), (ends[0] - ends[1]) / 2, rtol=1e-5, atol=1e-14)


def test_the_prior_pulls_towards_itself(calibration):
    """At its own errors it pulls nowhere; beside them its energy is that of the step in its covariance."""
    prior = prior_of(calibration, None, None)
    assert prior.terms(calibration.errors).energy == pytest.approx(0.0, abs=1e-12)
    step = np.zeros((4, 12))
    step[2, 6] = 1e-9
    terms = prior.terms(SensorErrors.from_vector(calibration.errors.to_vector() + step))
    assert terms.energy == pytest.approx(step.ravel() @ prior.precision @ step.ravel(), rel=1e-6)
    free = np.delete(np.arange(48), [9, 10, 11])
    assert_allclose(terms.score[free], -(prior.precision @ step.ravel())[free], rtol=1e-4)


def test_without_scalar_the_scale_is_no_knowledge(recording, cross):
    """A common scale costs nothing beside a calibration that had none."""
    prior = prior_of(maximum_likelihood(replace(recording, scalar_T=None), cross), None, None)
    assert not prior.knows_scale
    scaled = replace(prior.errors, scale_factor=1.01 * prior.errors.scale_factor)
    assert prior.terms(scaled).energy == pytest.approx(0.0, abs=1e-9)


def test_no_prior_without_a_covariance(calibration):
    """One with a negative variance of a combination ends in a sentence."""
    covariance = calibration.covariance.copy()
    covariance[0, 1] = covariance[1, 0] = 10 * np.sqrt(covariance[0, 0] * covariance[1, 1])
    with pytest.raises(InputError, match="negative variance"):
        prior_of(replace(calibration, covariance=covariance), None, None)
    with pytest.raises(InputError, match="not finite"):
        prior_of(replace(calibration, covariance=np.full((48, 48), np.inf)), None, None)
