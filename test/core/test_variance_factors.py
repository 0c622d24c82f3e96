"""Factors of the two channels are compared and combined each with its like."""

import pytest

from tam_calibration.core.noise import WHITE, VarianceFactors


@pytest.mark.parametrize(
    ("factors", "do_exceed"),
    [((2.1, 8.7), False), ((2.3, 8.0), True), ((2.0, 8.9), True), ((1.0, 1.0), False)],
)
def test_one_that_is_larger_by_more_than_the_part_is_enough(factors, do_exceed):
    """A tenth of 2 and of 8; one that is smaller makes up for nothing."""
    assert VarianceFactors(*factors).exceed(VarianceFactors(2.0, 8.0), 0.1) == do_exceed


def test_the_larger_of_each_two_is_taken():
    """Each channel by itself; white noise is the least there is."""
    assert VarianceFactors(3.0, 1.0).at_least(VarianceFactors(2.0, 5.0)) == VarianceFactors(3.0, 5.0)
    assert VarianceFactors(3.0, 50.0).times(0.1).at_least(WHITE) == VarianceFactors(1.0, 5.0)
