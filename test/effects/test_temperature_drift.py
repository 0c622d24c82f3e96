"""Bias and scale factor that drift with temperature."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.effects.fitted import Contribution, FittedEffect
from tam_calibration.effects.memory import Memory
from tam_calibration.effects.temperature_drift import TemperatureDrift

SHAPE = {"time_constant_s": 4.0, "reference_C": 20.0}
EFFECT = TemperatureDrift()


def test_coefficients_come_back(turning, refitted):
    """Offset, scale and second order of a row are told from the calibration and from each other."""
    deviation, error = refitted(EFFECT, turning(), SHAPE, (1, 0, "offset"), (1, 0, "scale"), (1, 2, "quadratic offset"))
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


def test_a_mixture_of_lags_is_within_the_terms(turning, refitted):
    """A second, slower lag is told from the first."""
    deviation, _ = refitted(EFFECT, turning(), SHAPE, (0, 1, "offset"), (0, 1, "slower offset"))
    assert np.abs(deviation).max() < 4


def test_the_reference_temperature_adds_nothing(turning):
    """At its reference temperature a sensor reads as calibrated."""
    situation = turning(samples=50)
    at_rest = replace(situation, temperature_C=np.full(50, SHAPE["reference_C"]))
    assert all(not term.features.any() for term in EFFECT.terms(at_rest, SHAPE))


def test_it_goes_on_from_batch_to_batch(turning):
    """Taken off while samples arrive it is what it is in the whole recording."""
    situation = turning()
    fitted = FittedEffect(EFFECT.name, SHAPE, (Contribution(2, 1, "slower offset", {"slower offset": 1e-9}),))
    memory, parts = Memory(), []
    for batch in (slice(0, 1), slice(1, 300), slice(300, 1200)):
        memory.rewind()
        parts.append(EFFECT.signal(replace(situation.take(batch), memory=memory), fitted))
    assert_allclose(np.concatenate(parts), EFFECT.signal(situation, fitted), atol=1e-20)


def test_a_constant_temperature_shows_nothing(turning):
    """Some hundredths of a kelvin are no change."""
    situation = turning()
    steady = 20 + 0.02 * np.random.default_rng(1).normal(size=situation.sample_count)
    assert EFFECT.obstacle(situation) is None
    assert "changes by 0.0" in EFFECT.obstacle(replace(situation, temperature_C=steady))


def test_lags_reach_from_none_to_a_third_of_the_record(turning, left_by):
    """Few are tried, with one reference."""
    situation = turning()
    shapes = EFFECT.shapes(situation, left_by(EFFECT, situation, SHAPE))
    constants = [shape["time_constant_s"] for shape in shapes]
    assert constants[0] == 0
    assert_allclose(constants[-1], 0.05 * 1199 / 3)
    assert len(constants) <= 8
    assert {shape["reference_C"] for shape in shapes} == {float(np.mean(situation.temperature_C))}
