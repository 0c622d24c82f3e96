"""The line through the missions is the weighted least-squares line, with standard errors that hold."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.fleet.summary import all_missions, fit_drift
from tam_calibration.fleet.task import Result
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.units import ERROR_KINDS


@given(st.integers(4, 30), st.integers(0, 2**32 - 1))
def test_the_line_is_that_of_numpy(missions, seed):
    """Slope, mean and scatter are those of `numpy.polyfit`, the standard errors wider where the scatter is above 1."""
    rng = np.random.default_rng(seed)
    days, errors = np.sort(rng.uniform(0, 100, missions)), rng.uniform(0.5, 2, missions)
    values = 3 + 0.1 * days + rng.uniform(0.3, 3) * errors * rng.normal(size=missions)
    found = fit_drift(1.7e9 + days * DAY_S, values, errors)
    line, covariance = np.polyfit(days - days.mean(), values, 1, w=1 / errors, cov="unscaled")
    scatter = math.sqrt((((values - np.polyval(line, days - days.mean())) / errors) ** 2).sum() / (missions - 2))
    assert_allclose(found.per_day, line[0], rtol=1e-6, atol=1e-9)
    assert_allclose(found.per_day_standard_error, math.sqrt(covariance[0, 0]) * max(1, scatter), rtol=1e-6)
    assert_allclose(found.scatter, scatter, rtol=1e-6)
    assert_allclose(found.mean, np.average(values, weights=errors**-2.0), rtol=1e-9)


def test_standard_errors_hold():
    """Over many simulated fleets the slope lies within its standard error as often as it must: 68 % and 95 %."""
    rng = np.random.default_rng(7)
    time_s, errors = 1.7e9 + np.linspace(0, 9e6, 40), rng.uniform(0.5, 2, 40)
    found = [
        fit_drift(time_s, 0.2 * (time_s - 1.7e9) / 86400 + errors * rng.normal(size=40), errors) for _ in range(2000)
    ]
    away = np.array([abs(one.per_day - 0.2) / one.per_day_standard_error for one in found])
    # A widening that is 1 or more makes them hold a little more often.
    assert 0.66 < (away < 1).mean() < 0.75
    assert 0.94 < (away < 2).mean() < 0.98


def test_what_was_not_determined_does_not_count():
    """A parameter that was held fixed (error 0) or whose error is not known is left out."""
    time_s, values = np.arange(4) * DAY_S, np.array([0.0, 1.0, 2.0, 50.0])
    assert fit_drift(time_s, values, np.array([1.0, 1.0, 1.0, np.nan])).per_day == pytest.approx(1)
    assert fit_drift(time_s, values, np.array([1.0, 1.0, 1.0, 0.0])).missions == 3
    assert fit_drift(time_s, values, np.zeros(4)) is None


@pytest.mark.parametrize("time_s", [[5.0], [5.0, 5.0], [1.7e9, 1.7e9, 1.7e9], [5.0, 65.0], [60.0, 30.0, 45.0, 31.0]])
def test_missions_at_one_time_tell_no_drift(time_s):
    """The mean is told, the slope is not, as the missions lie no further apart than the longest of them lasts."""
    found = fit_drift(np.array(time_s), np.full(len(time_s), 3.0), np.full(len(time_s), 2.0), 60.0)
    assert found.mean == pytest.approx(3) and found.mean_standard_error == pytest.approx(2 / math.sqrt(len(time_s)))
    assert math.isnan(found.per_day) and math.isnan(found.significance)


def test_two_missions_tell_a_drift_without_scatter():
    """The standard error is then what the two calibrations state."""
    found = fit_drift(np.array([0, 2 * DAY_S]), np.array([1.0, 5.0]), np.array([3.0, 4.0]))
    assert (found.per_day, found.per_day_standard_error) == pytest.approx((2.0, 2.5))
    assert math.isnan(found.scatter)


def result(first_s, last_s):
    """Return the result of a mission whose parameters differ from those of others."""
    sensor = {key: [1 + first_s % 7] * 3 for kind in ERROR_KINDS for key in (kind.key(), kind.key("standard_error"))}
    return Result("dive", "auv", "dive", "done", {}, "", time_span_s=(first_s, last_s), sensors=[sensor])


@pytest.mark.parametrize(
    ("spans_s", "why"),
    [
        ([(0, 100), (0, 120), (0, 80)], "no drift: the missions have one time"),
        ([(3.2, 60), (7.9, 90)], "no drift: the missions have one time"),
        ([(1.7e9, 1.7e9 + 60)] * 3, "no drift: the missions have one time"),
        ([(-5, 60), (400, 500), (9000, 9100)], "no drift: the times of the missions do not count from 1970"),
        ([(0, 60), (1.7e9, 1.7e9 + 60)], "no drift: the times of the missions do not count from 1970"),
        ([(1.7e9, 1.7e9 + 60), (1.7e9 + 100, 1.7e9 + 190)], ""),
        ([(0, 100)], ""),
    ],
)
def test_times_that_cannot_be_compared_tell_no_drift(spans_s, why):
    """As those of recorders that count from their start; the reason is a sentence."""
    [missions] = all_missions([result(*span) for span in spans_s])
    assert missions.no_drift == why
    told = [math.isfinite(found.drift.per_day) for found in missions.drifts()]
    assert told and all(told) == any(told) == (not why and len(spans_s) > 1)
