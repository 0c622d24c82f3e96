"""Probabilities of causes from what a case shows, and the smallest set of answers that holds the true one."""

from dataclasses import replace
from itertools import permutations
from math import exp, log
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.courses import TemperatureDrift
from tam_calibration.effects.curves import Nonlinearity
from tam_calibration.gap.causes import energies_of, features_of, probabilities, right, set_of, shares_of
from tam_calibration.gap.size import Evidence
from tam_calibration.gap.steps import Step
from tam_calibration.model.fitted_effect import Contribution, FittedEffect


def cause(name):
    """Return what a set needs of a cause: its name."""
    return SimpleNamespace(fitted=SimpleNamespace(effect=name))


def test_what_leaves_less_is_more_likely():
    """So is what makes more of what closes, and what has no rival with as much evidence."""
    whole = right(features_of(0, 1.0, 500.0, 50.0, 1.0))
    assert right(features_of(2, 1.0, 500.0, 50.0, 1.0)) < whole < 1
    assert right(features_of(0, 0.3, 500.0, 50.0, 1.0)) < whole
    assert right(features_of(0, 1.0, 500.0, 400.0, 1.0)) < whole
    assert right(features_of(0, 1.0, 500.0, 50.0, 0.5)) < whole


def test_what_is_smaller_than_what_would_be_seen_counts_as_that():
    """Evidence as the least that counts, and an open part as the accuracy of models."""
    ratio, part = pytest.approx(log(10)), pytest.approx(log(0.01))
    assert features_of(1, 0.5, 120.0, -40.0, 1.0) == (1.0, pytest.approx(log(2)), 0.5, ratio, part)
    assert features_of(0, 0.5, 12.0, 24.0, 0.0) == (1.0, 0.0, 0.5, pytest.approx(-log(2)), pytest.approx(log(1.01)))


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


DRIFT = {"time_constant_s": 0.0, "reference_C": 20.0}
CURVE = {"full_scale_T": 6e-5}


def given(effect, shape, row, term):
    """Return an effect in one row."""
    return effect, FittedEffect(effect.name, shape, (Contribution(*divmod(row, 3), term, {}),))


@pytest.fixture(scope="module")
def disturbed(run):
    """Return a run with a drift in one axis, and a curve and a lagged drift in another."""
    made = run(500)
    change = made.recording.temperature_C - 20
    field = made.recording.readings_T[:, 2, 2] / 5e-5
    return made.with_row(4, 4e-9 * change).with_row(8, 30e-9 * field**3 + 2e-9 * change)


EFFECTS = (
    given(TemperatureDrift(), DRIFT, 4, "offset"),
    given(Nonlinearity(), CURVE, 8, "cubic"),
    given(TemperatureDrift(), {**DRIFT, "time_constant_s": 0.5}, 8, "offset"),
)


def fitted(made, effects, accepted):
    """Return the model with effects accepted one after another."""
    model = made.model()
    for effect, one in effects:
        model = accepted(model, effect, one)
    return model


@pytest.fixture(scope="module")
def model(disturbed, accepted):
    """Return the model with all three."""
    return fitted(disturbed, EFFECTS, accepted)


def test_shares_add_up_to_one_in_any_order(model):
    """Parts in another order have the same shares in that order."""
    shares = shares_of(model)
    assert shares.sum() == pytest.approx(1) and (shares > 0.01).all()
    for order in permutations(range(3)):
        again = shares_of(replace(model, parts=tuple(model.parts[index] for index in order)))
        assert_allclose(again, shares[list(order)], rtol=1e-6)


def test_shares_are_the_means_over_all_orders(model, dense, disturbed):
    """Of what each adds when it comes in, by dense least squares at the errors of the fit."""
    made = replace(disturbed, errors=model.errors)
    channels, truth = model.channels(), dense(made)
    designs = [channels.design(part.terms(channels)) for part in model.parts]
    added = np.zeros(3)
    for order in permutations(range(3)):
        left = truth.left(channels.calibration)
        for place, index in enumerate(order):
            after = truth.left(channels.calibration, *(designs[one] for one in order[: place + 1]))
            added[index] += left - after
            left = after
    assert_allclose(shares_of(model), added / added.sum(), rtol=1e-3)


def test_the_same_effect_twice_shares_evenly(run, accepted):
    """Two parts that say the same have half each."""
    made = run(300)
    made = made.with_row(4, 4e-9 * (made.recording.temperature_C - 20))
    model = fitted(made, EFFECTS[:1], accepted)
    assert_allclose(shares_of(replace(model, parts=model.parts * 2)), [0.5, 0.5], rtol=1e-6)


def test_effects_without_overlap_have_their_own_energy(run, accepted):
    """Drifts of two sensors at times of their own, turned so that neither sees the other: each has what it explains."""
    made = run(400)
    change = made.recording.temperature_C - 20
    made = made.with_row(4, 6e-9 * change).with_row(11, 3e-9 * change)
    effects = [given(TemperatureDrift(), DRIFT, row, "offset") for row in (4, 11)]
    model = fitted(made, effects, accepted)
    channels = model.channels()
    base = model.base()
    alone = [base.channels.design(part.terms(channels)) for part in model.parts]
    projected = [type(base)(channels, [channels.calibration]).project(design).gain()[0] for design in alone]
    # Axes y and z of two sensors meet only through the field that they share.
    assert_allclose(shares_of(model), np.array(projected) / sum(projected), atol=0.05)


def test_one_effect_or_none(model):
    """The only effect has all."""
    assert shares_of(replace(model, parts=model.parts[:1])).tolist() == [1.0]
    assert shares_of(replace(model, parts=())).size == 0


@pytest.mark.parametrize(("at", "odds"), [(0, -0.76), (1, -0.45), (2, 1.51), (3, 0.4), (4, -0.5)])
def test_each_feature_moves_the_odds_as_it_was_found_to(at, odds):
    """The logistic regression: intercept, failing checks, share, ratio of the evidences, and the open part."""
    assert right(np.eye(5)[at]) == pytest.approx(1 / (1 + exp(-odds)), rel=1e-12)


def searched(steps=(), gains=(("a", 30.0), ("b", 10.0), ("c", -5.0))):
    """Return a search of 1000 channels that weighed some effects."""
    base = SimpleNamespace(channels=SimpleNamespace(count=1000.0))
    weighed = tuple(SimpleNamespace(effect=name, gain=gain, delta_bic=gain - 7) for name, gain in gains)
    return SimpleNamespace(weighed=weighed, steps=steps, nominal=SimpleNamespace(base=lambda: base))


@pytest.mark.parametrize(
    ("verdict", "answer", "other", "chance"),
    [("no_gap", "no_gap", "none_of_these", 35 / 38), ("unexplained", "none_of_these", "no_gap", 44 / 50)],
)
def test_a_verdict_without_a_cause_is_as_right_as_it_was_on_the_blind_set(verdict, answer, other, chance):
    """34 of 36 and 43 of 48, by Laplace's rule; half of the rest is the other, half the effects' by their gains."""
    found = probabilities(searched(), verdict, SimpleNamespace(before=0.5), 0)
    assert found[answer] == pytest.approx(chance, rel=1e-12)
    assert found[other] == pytest.approx((1 - chance) / 2)
    assert [found["a"], found["b"], found["c"]] == pytest.approx([0.375 * (1 - chance), 0.125 * (1 - chance), 0.0])
    assert sum(found.values()) == pytest.approx(1)


def test_a_gap_beyond_any_noise_is_a_gap():
    """An unexplained gap of ten floors has no chance of being none, so that its 95 % set does not hold that."""
    found = probabilities(searched(), "unexplained", SimpleNamespace(before=10.0), 0)
    assert found["no_gap"] == 0
    assert sum(found.values()) == pytest.approx(1)
    assert set_of(found, "unexplained", ()) == ("unknown", "a")


def test_a_cause_is_as_likely_as_its_features_say():
    """Its share is of what all causes explain; half of the rest is of none of these, half of what was not named."""
    steps = tuple(Step(Evidence(name, None, gain - 7, gain), None) for name, gain in (("a", 300.0), ("b", 100.0)))
    energy = energies_of(steps, 1000.0)
    assert list(energy.values()) == pytest.approx([1 - exp(-0.3), exp(-0.3) * (1 - exp(-0.1))])
    weighed = searched(steps, (("a", 300.0), ("b", 100.0), ("c", 60.0)))
    found = probabilities(weighed, "explained", SimpleNamespace(closed=0.9), 1)
    total = sum(energy.values())
    for step, name, evidence in zip(steps, "ab", (293.0, 93.0), strict=True):
        assert found[name] == pytest.approx(right(features_of(1, energy[step] / total, evidence, 53.0, 0.9)))
    rest = 1 - min(found["a"], found["b"])
    assert (found["none_of_these"], found["c"], found["no_gap"]) == (
        pytest.approx(rest / 2),
        pytest.approx(rest / 2),
        0,
    )
