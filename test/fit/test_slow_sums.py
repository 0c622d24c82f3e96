"""Sums of scores tell white noise, larger noise, noise that lasts, and noise that lasts as long as the recording."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tam_calibration.core.noise import BLOCKS, SlowSums

PARAMETERS = 20
INFORMATION = np.tile(np.eye(PARAMETERS) / BLOCKS, (BLOCKS, 1, 1))


def shown(kept, size, seed):
    """Return what scores show whose noise keeps a part of itself from each of twenty moments of a block to the next."""
    white = np.random.default_rng(seed).normal(size=(20 * BLOCKS, PARAMETERS))
    noise = size * lfilter([1], [1, -kept], white, axis=0)
    return SlowSums.of(INFORMATION, noise.reshape(BLOCKS, 20, -1).sum(axis=1) / np.sqrt(20 * BLOCKS))


def test_white_noise_of_the_stated_size_shows_nothing():
    """But for once or so in a thousand recordings."""
    scores = [np.random.default_rng(seed).normal(size=(BLOCKS, PARAMETERS)) for seed in range(1000)]
    assert sum(SlowSums.of(INFORMATION, each / np.sqrt(BLOCKS)) != SlowSums() for each in scores) <= 4


@pytest.mark.parametrize(("kept", "size", "factor"), [(0, 2, 4), (0.5, 1, 4), (0.6, 1, 6.25)])
def test_the_factor_is_that_of_the_variance(kept, size, factor):
    """Of larger noise the square of its size, of noise that lasts the square of 1 / (1 - kept); both end in time."""
    found = [shown(kept, size, seed) for seed in range(40)]
    assert np.mean([each.factor for each in found]) == pytest.approx(factor, rel=0.15)
    assert sum(each.is_growing for each in found) <= 1


def test_noise_that_never_ends_is_growing():
    """A random walk moves the slowest sums more than any white noise does."""
    assert all(shown(1, 1, seed).is_growing for seed in range(40))
