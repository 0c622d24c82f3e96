"""Chance by permutation: who may have whose residual, and how rare a statistic must be."""

import numpy as np

from tam_calibration.effects.within_motion import is_chance

RATE = np.random.default_rng(1).uniform(0, 1, 1000)


def dealt_out(rate):
    """Return all ways in which residuals are dealt out, those as they are first."""
    seen = []

    def statistic(dealt):
        seen.append(dealt.copy())
        return 1.0 if len(seen) == 1 else 0.0

    assert not is_chance(statistic, rate)
    return seen


def test_residuals_are_dealt_out_two_hundred_times():
    """All other ways differ from the one observed, and from each other."""
    observed, *others = dealt_out(RATE)
    assert observed.tolist() == list(range(1000)) and len(others) == 200
    assert len({tuple(one) for one in others}) == 200


def test_no_sample_keeps_its_own_and_all_come_from_like_motion():
    """A residual moves to a sample whose rate is among the next two hundred in order, and to any of these."""
    place = np.argsort(np.argsort(RATE))
    moved = np.array([np.abs(place[one] - place) for one in dealt_out(RATE)[1:]])
    assert moved.min() > 0 and 150 < moved.max() < 200
    for one in dealt_out(RATE)[1:4]:
        assert sorted(one) == list(range(1000))


def test_one_permutation_that_reaches_as_much_is_enough():
    """Even the last of them."""
    for reached, told in ((2.0, True), (1.0, True), (0.9, False)):
        values = iter([1.0, *[0.0] * 199, reached])
        assert is_chance(lambda dealt, values=values: next(values), RATE) == told


def test_what_follows_the_motion_is_no_chance():
    """Products with what each sample does stand out where they are real, and hardly ever otherwise."""
    generator = np.random.default_rng(2)
    found = []
    for strength in (0.3, *[0.0] * 100):
        path = generator.normal(size=1000)
        residual = strength * path + generator.normal(size=1000)
        found.append(not is_chance(lambda dealt, path=path, one=residual: float(path @ one[dealt]), np.abs(path)))
    assert found[0] and sum(found[1:]) <= 3


def test_a_short_record_is_dealt_out_as_a_whole():
    """Twenty samples, fewer than are alike, do not fail."""
    assert is_chance(lambda dealt: 1.0, RATE[:20])
