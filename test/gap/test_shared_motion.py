"""Sensors that are turned together see the same motion; noise shares none."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.gap.shared_motion import canonical_correlations, sure_correlation


def test_any_mounting_shares_all_of_the_motion():
    """A linear map of the readings, shifted."""
    readings = np.random.default_rng(0).normal(size=(500, 1, 3))
    both = np.concatenate([readings, readings @ [[0, 2, 0], [1, 0, 0.3], [0, 0, -1]] + 7], axis=1)
    assert_allclose(canonical_correlations(both), 1, atol=1e-12)


def test_half_of_noise_leaves_its_part():
    """Equal parts of signal and noise in one of two: the root of a half."""
    generator = np.random.default_rng(1)
    signal = generator.normal(size=(20000, 3))
    both = np.stack([signal, signal + generator.normal(size=signal.shape)], axis=1)
    assert_allclose(canonical_correlations(both)[1], np.sqrt(0.5), atol=0.02)


@pytest.mark.parametrize(("samples", "sure"), [(20, 0.5), (900, 0.5), (2500, 0.3), (10000, 0.15)])
def test_what_is_sure_falls_with_the_root_of_the_samples(samples, sure):
    """Noise stays below."""
    assert sure_correlation(samples) == pytest.approx(sure)
    if samples > 100:
        noise = np.random.default_rng(2).normal(size=(samples, 2, 3))
        assert canonical_correlations(noise)[1].max() < 0.4 * sure


def test_spikes_do_not_hide_the_motion():
    """One reading in a hundred is a thousand times as large."""
    readings = np.random.default_rng(3).uniform(-1, 1, size=(1000, 1, 3))
    both = np.concatenate([readings, readings], axis=1)
    both[::100, 1, 0] = 1000
    assert canonical_correlations(both)[1].min() > 0.6
