"""Noise with outliers: what an estimate that weighs them varies by."""

import numpy as np
import pytest

from tam_calibration.fit.student_noise import StudentNoise


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
