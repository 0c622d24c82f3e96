"""Change points of functions in residuals."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.bias_jump import BiasJump
from tam_calibration.effects.change_points import Path, without
from tam_calibration.effects.crosstalk import Crosstalk

COUNT = 600


def made(cuts, size=1.0, channels=3, seed=4):
    """Return residuals in which a wave changes between samples, what is fitted anyway, and the wave."""
    generator = np.random.default_rng(seed)
    wave = np.column_stack([np.sin(0.3 * np.arange(COUNT)), np.cos(0.21 * np.arange(COUNT))])
    inside = (np.arange(COUNT) > cuts[0]) & (np.arange(COUNT) <= (cuts[1] if len(cuts) > 1 else COUNT))
    residual = generator.normal(size=(COUNT, channels)) + size * inside[:, None] * wave @ generator.normal(
        size=(2, channels)
    )
    return residual, np.column_stack([np.ones(COUNT), wave]), wave


@pytest.mark.parametrize("cuts", [(217,), (217, 404)])
def test_the_gain_is_that_of_a_regression(cuts):
    """What a change explains is what least squares with it explain beyond those without."""
    residual, nuisance, wave = made(cuts)
    change = Path.of(*without(residual, nuisance), wave).best()[len(cuts) - 1]
    first, last = change.cuts[0], (*change.cuts, COUNT)[1]
    inside = ((np.arange(COUNT) > first) & (np.arange(COUNT) <= last))[:, None]
    both = np.column_stack([nuisance, inside * wave])
    left = [
        np.sum((residual - design @ np.linalg.lstsq(design, residual, rcond=None)[0]) ** 2)
        for design in (nuisance, both)
    ]
    assert_allclose(change.gain, left[0] - left[1], rtol=1e-4)


@pytest.mark.parametrize("stride", [1, 7])
@pytest.mark.parametrize("cuts", [(217,), (217, 404)])
def test_changes_are_found_to_the_sample(cuts, stride):
    """Sought at every seventh sample first, too."""
    residual, nuisance, wave = made(cuts, size=3.0)
    change = Path.of(*without(residual, nuisance), wave).best(stride)[len(cuts) - 1]
    assert np.abs(np.subtract(change.cuts, cuts)).max() <= 3


def test_two_channels_add_up():
    """A path beside another has the gain of both."""
    residual, nuisance, wave = made((217,))
    left, basis = without(residual, nuisance)
    own, other = (Path.of(left[:, [channel]], basis, wave[:, :1]) for channel in (0, 1))
    alone, together = own.best()[0], own.beside(other).best()[0]
    assert own.width == 1 and Path.of(left, basis, wave).width == 6
    assert together.gain != alone.gain
    same = own.beside(own).best()[0]
    assert_allclose(same.gain, 2 * alone.gain, rtol=1e-6)
    assert same.cuts == alone.cuts


def test_what_counts_for_nothing_changes_nothing():
    """Without information there is no gain, and nothing that is not finite."""
    path = Path.of(np.zeros((COUNT, 2)), np.zeros((COUNT, 1)), np.zeros((COUNT, 1)))
    assert [change.gain for change in path.best()] == [0, 0]


@pytest.mark.parametrize(("length", "is_change"), [(6, False), (13, True)])
def test_what_lasts_as_long_as_a_burst_is_no_change(length, is_change):
    """Six samples that are off at the end of the record are outliers, thirteen are a change; so are they within it."""
    for start in (COUNT - length, 300):
        residual = np.random.default_rng(1).normal(size=(COUNT, 1))
        residual[start : start + length] += 30
        single, pair = Path.of(*without(residual, np.ones((COUNT, 1))), np.ones((COUNT, 1))).best()
        found = single.cuts == (start - 1,) if start > 300 else pair.cuts == (start - 1, start + length - 1)
        assert found == is_change


@pytest.mark.parametrize("effect", [BiasJump(), Crosstalk()], ids=lambda effect: effect.name)
def test_twenty_samples_have_no_before_and_after(turning, effect):
    """Thirty have."""
    assert "too few" in effect.obstacle(turning(samples=20))
    assert effect.obstacle(turning(samples=30)) is None
