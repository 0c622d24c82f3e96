"""Probabilities of causes from what a case shows, and the smallest set of answers that holds the true one."""

from math import log
from types import SimpleNamespace

import pytest

from tam_calibration.gap.probability import features_of, right, set_of
from tam_calibration.gap.standing import Standing


def cause(name):
    """Return what a set needs of a cause: its name."""
    return SimpleNamespace(fitted=SimpleNamespace(effect=name))


def test_what_closes_more_of_a_gap_is_more_likely():
    """So is what makes more of what closes."""
    standing = Standing(300.0, 100.0, 0.01)
    assert right(standing, 0.3, 0.5) < right(standing, 0.9, 0.5) < right(standing, 0.9, 1.0) < 1


def test_a_ratio_counts_up_to_ten():
    """A fact of the readings, which has no surrogates, counts as much; what is below one counts as one."""
    assert features_of(Standing(300.0, 100.0, 0.01), 0.9, 0.5) == (1.0, pytest.approx(log(3)), 0.9, 0.5)
    assert features_of(Standing(9000.0, 100.0, 0.01), 0.9, 0.5) == features_of(None, 0.9, 0.5)
    assert features_of(Standing(50.0, 100.0, 0.01), 0.9, 0.5)[1] == 0
    assert features_of(None, 0.9, 0.5)[1] == pytest.approx(log(10))


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
