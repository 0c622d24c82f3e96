"""The spectrum of noise that interpolation makes, from its correlation."""

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.model.recording import LAGS, InterpolatedNoise


def test_the_spectrum_is_that_of_the_filter():
    """Of white noise it is 1; of means of two readings twice the squared cosine, but for a rest near their zero."""
    correlation = np.zeros((2, LAGS))
    correlation[1, 0] = 0.5
    frequency = np.linspace(0, 0.5, 11)
    spectrum = InterpolatedNoise(correlation, np.ones(2)).spectrum(frequency)
    assert_allclose(spectrum[0], 1)
    assert_allclose(spectrum[1, :-1], 2 * np.cos(np.pi * frequency[:-1]) ** 2, atol=0.01)
    assert 0 < spectrum[1, -1] < 0.1
