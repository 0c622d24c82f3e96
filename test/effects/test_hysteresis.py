"""Readings that depend on where the field came from."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.effects.curves import Hysteresis
from tam_calibration.effects.recursions import play, rounded_loop

EFFECT = Hysteresis()
SHAPE = {"full_scale_T": 50e-6}


def test_coefficients_come_back(turning, refitted):
    """Loops of all kinds of an axis are told from the calibration."""
    keys = [(1, 1, name) for name in ("loop", "rounded loop", "saturating loop")]
    deviation, error = refitted(EFFECT, turning(), SHAPE, *keys)
    assert np.abs(deviation).max() < 4
    assert np.median(error) < 0.5


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 1000), st.integers(1, 120))
def test_plays_are_those_of_their_recursion(seed, count):
    """Worked through in blocks, states are those of sample after sample."""
    drive, widths = np.cumsum(np.random.default_rng(seed).normal(size=(count, 2)), axis=0), np.array([0.1, 1.0, 4.0])
    state, expected = np.zeros((2, 3)), []
    for now in drive[:, :, None]:
        state = np.minimum(now + widths, np.maximum(now - widths, state))
        expected.append(state)
    assert_allclose(play(drive, widths), expected, atol=0)


def test_a_rounded_loop_forgets_along_its_way():
    """Up by a way s from rest it is w (1 - exp(-s / w)); the rate does not matter."""
    drive = np.array([0.0, 0.5, 2.0, 2.0, 3.0])[:, None]
    assert_allclose(rounded_loop(drive, 2.0)[:, 0], 2 * (1 - np.exp(-drive[:, 0] / 2)))


def test_the_rate_does_not_matter(turning):
    """The same way in another time, and with rests, makes the same loops."""
    covariates = turning()
    slow = replace(covariates.take(np.repeat(np.arange(1200), 2)), time_s=0.2 * np.arange(2400))
    for quick, rested in zip(EFFECT.terms(covariates, SHAPE), EFFECT.terms(slow, SHAPE), strict=True):
        assert_allclose(rested.features[::2], quick.features, atol=1e-12 * np.abs(quick.features).max())


@pytest.mark.parametrize("kind", ["relays", "friction"])
def test_loops_of_other_makes_are_within_the_terms(turning, kind):
    """Preisach's relays of scattered thresholds and Bouc and Wen's equation are met to a sixth of their amplitude."""
    covariates = turning(samples=3000, step_s=0.1)
    way = covariates.sensed_T[:, 4] / 50e-6
    if kind == "relays":
        generator = np.random.default_rng(1)
        middle, width = generator.normal(0, 0.3, 500), np.abs(generator.normal(0, 0.25, 500))
        state, signal = np.ones(500), []
        for now in way:
            state = np.where(now > middle + width, 1, np.where(now < middle - width, -1, state))
            signal.append(state.mean())
    else:
        signal = [0.0]
        for change in np.repeat(np.diff(way) / 8, 8):
            signal.append(signal[-1] + 4 * change - 5 * abs(change) * signal[-1])
        signal = signal[::8]
    curves = [term.features for term in EFFECT.terms(covariates, SHAPE) if (term.sensor, term.axis) == (1, 1)]
    linear = np.column_stack([np.ones(3000), covariates.field_T / 50e-6])

    def left(*functions):
        basis = np.column_stack([linear, *functions])
        basis = basis / np.abs(basis).max(axis=0)
        return np.linalg.norm(signal - basis @ np.linalg.lstsq(basis, np.array(signal), rcond=1e-10)[0])

    assert left(*curves) < left() / 6


def test_a_field_that_is_not_turned_back_shows_nothing(turning):
    """A single turn one way has no loop."""
    covariates = turning(samples=1200)
    rising = np.linspace(0.2, 0.9, 1200)
    field = 50e-6 * np.column_stack([rising, np.sqrt(1 - rising**2 - 0.01), np.full(1200, 0.1)])
    aligned = replace(covariates.errors, non_orthogonality=np.zeros((4, 3)), misalignment=np.zeros((4, 3)))
    assert "no axis" in EFFECT.obstacle(replace(covariates, field_T=field, errors=aligned))
    assert EFFECT.obstacle(covariates) is None
