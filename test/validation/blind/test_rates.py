import math

import numpy as np
import pytest
from scipy.stats import binomtest, mannwhitneyu

from tam_validation.blind.rates import (
    Rate,
    calibration_error,
    constant_log_score,
    log_score,
    reliability_curve,
    separation,
)


@pytest.mark.parametrize(("hits", "cases"), [(0, 10), (97, 100), (44, 44)])
def test_intervals_are_wilsons(hits, cases):
    """The interval is that of another library."""
    expected = binomtest(hits, cases).proportion_ci(method="wilson")
    assert Rate(hits, cases).interval == pytest.approx((expected.low, expected.high), abs=1e-9)


def test_honest_probabilities_have_no_error():
    """What was told 3 times in 4 and came true 3 times in 4 lies on the diagonal."""
    curve = reliability_curve([(0.75, True), (0.75, True), (0.75, True), (0.75, False)])
    assert [(one.told, one.true, one.count) for one in curve] == [(0.75, 0.75, 4)]
    assert calibration_error(curve) == 0


def test_boasting_is_an_error():
    """Certainty that is wrong half of the time is half wrong."""
    assert calibration_error(reliability_curve([(1.0, True), (1.0, False)])) == 0.5


def test_log_score_is_the_surprise():
    """What was told a half surprises by ln 2 either way; certainty that is wrong by no more than ln 1000."""
    assert log_score([(0.5, True), (0.5, False)]) == pytest.approx(math.log(2))
    assert log_score([(0.8, True), (0.8, False)]) == pytest.approx(-math.log(0.8 * 0.2) / 2)
    assert log_score([(1.0, False)]) == pytest.approx(math.log(1000))


def test_a_constant_knows_how_often_its_group_is_right():
    """Two groups, each with Laplace's estimate of its own rate."""
    expected = -(3 * math.log(4 / 5) + math.log(2 / 3)) / 4
    assert constant_log_score([[True, True, True], [False]]) == pytest.approx(expected)


def test_separation_is_the_area_under_the_curve():
    """By another library; ties count half, and with one class only there is none."""
    told = [(0.9, True), (0.4, False), (0.7, True), (0.7, False), (0.2, True)]
    values, came = np.array(told).T
    expected = mannwhitneyu(values[came == 1], values[came == 0]).statistic / 6
    assert separation(told) == pytest.approx(expected)
    assert math.isnan(separation([(0.9, True)]))
