import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tam_calibration.report.blocks import count, fixed, join, number, ratio, sentence, with_error


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (8172.4, "8172"),
        (5.9912, "5.99"),
        (0.50049, "0.500"),
        (9.996, "10.0"),
        (-0.01234, "−0.0123"),
        (50123.4, "50\u202f123"),
        (1.234e-9, "1.23 × 10⁻⁹"),
        (0.0, "0"),
        (math.nan, "–"),
        (math.inf, "∞"),
    ],
)
def test_numbers_have_three_significant_digits(value, text):
    """Digits that say nothing are dropped, an integer part is never cut, and no value is written as nan or 1e-09."""
    assert number(value) == text


@given(st.floats(1e-3, 1e6), st.floats(1e-6, 10))
def test_error_has_two_significant_digits(value, error):
    """Value and standard error end at the same decimal, and the error is right to two digits."""
    left, right = with_error(value, error, 2).replace("\u202f", "").split(" ± ")
    assert float(right) == pytest.approx(error, rel=0.051)
    assert len(left.partition(".")[2]) == len(right.partition(".")[2])
    assert abs(float(left) - value) <= error


def test_error_that_is_unknown_or_zero():
    """Without a standard error only the value is given; a fixed value is said to be fixed."""
    assert with_error(1.23456, math.nan, 3) == "1.235"
    assert with_error(0.0, 0.0, 3) == "0 (fixed)"


def test_words_and_counts():
    """Lists, sentences and counts read as prose."""
    assert join(["a"]) == "a"
    assert join(["a", "b", "c"]) == "a, b and c"
    assert sentence("turn left.") == sentence("turn left") == "Turn left."
    assert count(1234567) == "1\u202f234\u202f567"
    assert fixed(-1.005, 1) == "−1.0"
    assert ratio(0.9951) == "1.00"
    assert ratio(123.4) == "123"
