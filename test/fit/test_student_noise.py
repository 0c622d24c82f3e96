"""Noise with outliers: what an estimate that weighs them varies by."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_t

from tam_calibration.fit.estimate import StudentNoise


@pytest.mark.parametrize("channel_count", [1, 4, 10])
def test_the_variance_of_a_robust_estimate_is_the_sandwich_of_its_weighted_channels(channel_count):
    """Mean square of w(|x|²) x over the square of its mean derivative, which central differences give."""
    samples, step, square = np.random.default_rng(3).normal(size=(2000, channel_count)), 1e-5, 0.7
    counts = np.full(len(samples), float(channel_count))

    def weighted(channels):
        return StudentNoise(np.sum(channels**2, axis=1), counts, square).weights[:, None] * channels

    shifts = step * np.eye(channel_count)
    slopes = [(weighted(samples + shift) - weighted(samples - shift)) @ shift / (2 * step**2) for shift in shifts]
    expected = np.mean(weighted(samples) ** 2) / np.mean(slopes) ** 2
    noise = StudentNoise(np.sum(samples**2, axis=1), counts, square)
    assert noise.variance_factor == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("scale", [0.3, 5.0])
def test_the_scale_is_the_most_likely_one(scale):
    """The likelihood of SciPy's multivariate t distribution with six degrees of freedom is largest there."""
    channels = scale * multivariate_t(shape=np.eye(4), df=6, seed=5).rvs(3000)
    noise = StudentNoise.of(np.sum(channels**2, axis=1), np.full(3000, 4.0))

    def unlikely(square):
        return -multivariate_t(shape=square * np.eye(4), df=6).logpdf(channels).sum()

    best = minimize_scalar(unlikely, bracket=(0.5 * scale**2, 2 * scale**2), tol=1e-10).x
    assert noise.square == pytest.approx(best, rel=1e-5)
    assert noise.square == pytest.approx(scale**2, rel=0.1)


def test_samples_of_no_noise_count_most():
    """1 + c/6 of c channels; half of that at a distance of √6 of the scale."""
    noise = StudentNoise(np.array([0.0, 6.0]), np.full(2, 3.0), 1.0)
    assert noise.weights.tolist() == [1.5, 0.75]


def test_samples_without_a_channel_count_for_nothing():
    """One sensor tells nothing where the scalar is missing: the noise is that of the other samples."""
    energy = np.random.default_rng(4).chisquare(3, 500)
    channels = np.full(500, 3.0)
    alone = StudentNoise.of(energy, channels)
    with_gaps = StudentNoise.of(np.append(energy, np.zeros(100)), np.append(channels, np.zeros(100)))
    assert with_gaps.square == pytest.approx(alone.square, rel=1e-9)
