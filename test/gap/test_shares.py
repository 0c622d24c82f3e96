"""Shares of what effects explain together are Shapley values of the explained energy."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.fitted import Contribution, FittedEffect
from tam_calibration.effects.nonlinearity import Nonlinearity
from tam_calibration.effects.temperature_drift import TemperatureDrift
from tam_calibration.gap.search import given_form
from tam_calibration.gap.shares import shares_of

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


def fitted(made, effects):
    """Return the model with effects accepted one after another."""
    model = made.model()
    for effect, one in effects:
        model = model.accept(given_form(model.base(), effect, one))
    return model


@pytest.fixture(scope="module")
def model(disturbed):
    """Return the model with all three."""
    return fitted(disturbed, EFFECTS)


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


def test_the_same_effect_twice_shares_evenly(run):
    """Two parts that say the same have half each."""
    made = run(300)
    made = made.with_row(4, 4e-9 * (made.recording.temperature_C - 20))
    model = fitted(made, EFFECTS[:1])
    assert_allclose(shares_of(replace(model, parts=model.parts * 2)), [0.5, 0.5], rtol=1e-6)


def test_effects_without_overlap_have_their_own_energy(run):
    """Drifts of two sensors at times of their own, turned so that neither sees the other: each has what it explains."""
    made = run(400)
    change = made.recording.temperature_C - 20
    made = made.with_row(4, 6e-9 * change).with_row(11, 3e-9 * change)
    effects = [given(TemperatureDrift(), DRIFT, row, "offset") for row in (4, 11)]
    model = fitted(made, effects)
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
