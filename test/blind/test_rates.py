import pytest
from scipy.stats import binomtest

from tam_calibration.blind.rates import Rate, calibration_error, reliability_curve


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
