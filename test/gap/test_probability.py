"""Probabilities of causes from what a case shows, and the smallest set of answers that holds the true one."""

from math import log
from types import SimpleNamespace

import pytest

from tam_calibration.gap.probability import features_of, right, set_of


def cause(name):
    """Return what a set needs of a cause: its name."""
    return SimpleNamespace(fitted=SimpleNamespace(effect=name))


def test_what_leaves_less_is_more_likely():
    """So is what makes more of what closes, and what has no rival with as much evidence."""
    whole = right(features_of(0, 1.0, 500.0, 50.0))
    assert right(features_of(2, 1.0, 500.0, 50.0)) < whole < 1
    assert right(features_of(0, 0.3, 500.0, 50.0)) < whole
    assert right(features_of(0, 1.0, 500.0, 400.0)) < whole


def test_what_is_smaller_than_what_would_be_seen_counts_as_that():
    """A rest as the smallest gap, and evidence as the least that counts."""
    assert features_of(1, 0.5, 120.0, -40.0) == (1.0, pytest.approx(log(2)), 0.5, pytest.approx(log(10)))
    assert features_of(0, 0.5, 12.0, 24.0) == (1.0, 0.0, 0.5, pytest.approx(-log(2)))


@pytest.mark.parametrize(
    ("chances", "verdict", "causes", "told"),
    [
        ({"no_gap": 0.95, "a": 0.05, "none_of_these": 0.0}, "no_gap", [], ("no_gap",)),
        ({"no_gap": 0.04, "a": 0.02, "none_of_these": 0.94}, "unexplained", [], ("unknown", "no_gap")),
        ({"no_gap": 0.0, "a": 0.97, "none_of_these": 0.03}, "explained", ["a"], ("a",)),
        ({"no_gap": 0.0, "a": 0.80, "b": 0.05, "none_of_these": 0.15}, "explained", ["a"], ("a", "unknown")),
        ({"a": 0.99, "b": 0.80, "c": 0.16, "none_of_these": 0.04}, "explained", ["a", "b"], ("a", "b", "c")),
        ({}, "not_identifiable", [], ()),
    ],
)
def test_the_set_is_the_smallest_that_is_sure(chances, verdict, causes, told):
    """Named causes first, all of them, then the most likely of the others until 95 % are reached."""
    assert set_of(chances, verdict, [cause(name) for name in causes]) == told
