"""Interference at a fixed frequency."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.fitted import SCALAR
from tam_calibration.effects.periodic_interference import PeriodicInterference

EFFECT = PeriodicInterference()
SHAPE = {"frequency_hz": 3.217, "start_s": 0.0}
LINE = {"cosine 1": 1e-9, "sine 1": -1e-9}


def test_coefficients_come_back(turning, refitted):
    """Lines and harmonics of an axis and of the scalar are told from the calibration."""
    keys = (0, 0, "line"), (0, 0, "harmonics"), (SCALAR, None, "line")
    deviation, error = refitted(EFFECT, turning(), SHAPE, *keys)
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


@pytest.mark.parametrize("kind", ["even", "holes", "odd holes", "uneven"])
@pytest.mark.parametrize("where", [(2, 0), (SCALAR, None)])
def test_a_line_of_the_size_of_the_noise_is_found(turning, left_by, kind, where):
    """Its frequency is among those tried, to a small part of the width of a line, in records with holes too."""
    finer = turning(samples=24_000, step_s=0.005)
    steps = np.full(2200, 10)
    if kind == "holes":
        steps[[500, 900]] = 600
    elif kind == "odd holes":
        steps[[500, 900]] = 613, 607
    elif kind == "uneven":
        steps = np.random.default_rng(3).integers(8, 13, 2200)
    situation = finer.take(np.cumsum(steps))
    misfit = left_by(EFFECT, situation, SHAPE, (*where, "line", LINE))
    tried = [shape["frequency_hz"] for shape in EFFECT.shapes(situation, misfit)]
    assert len(tried) <= 4
    assert np.abs(np.array(tried) - 3.217).min() < 0.1 / np.ptp(situation.time_s)


def test_lines_of_the_motion_are_not_proposed(turning, left_by):
    """What turns with the array is left to effects that depend on its attitude."""
    situation = turning()
    misfit = left_by(EFFECT, situation, {"frequency_hz": 0.1, "start_s": 0.0}, (1, 1, "line", {"cosine 1": 1e-7}))
    assert min(shape["frequency_hz"] for shape in EFFECT.shapes(situation, misfit)) > 0.3


def test_the_phase_does_not_depend_on_the_epoch(turning):
    """Times of day of today make the same waves as times from zero."""
    late = EFFECT.terms(turning(start_s=1.7e9), {"frequency_hz": 3.0, "start_s": 1.7e9})[0].features
    assert_allclose(late, EFFECT.terms(turning(), {"frequency_hz": 3.0, "start_s": 0.0})[0].features, atol=1e-5)


def test_few_samples_show_nothing(turning):
    """A spectrum needs some samples."""
    assert "too few" in EFFECT.obstacle(turning(samples=20))
