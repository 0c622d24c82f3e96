"""Noises whose level and spectrum are known, mixed as the residuals of sensors mix them."""

import numpy as np
from scipy.signal import lfilter

from tam_calibration.gap.noise import noise_of

STEP_S = 0.02


def against_the_mean(sensor_count):
    """Return how residuals against the mean of equal sensors mix the noise of their axes."""
    return np.kron(np.eye(sensor_count) - 1 / sensor_count, np.eye(3))


def shaped(kind, count, generator):
    """Return noise of unit variance: flicker, a random walk, an AR(1) process, or a band of 4.5 to 5.5 Hz."""
    white = generator.normal(size=4 * count)
    if kind == "flicker":
        frequency = np.fft.rfftfreq(4 * count)
        frequency[0] = np.inf
        series = np.fft.irfft(np.fft.rfft(white) / np.sqrt(frequency))
    elif kind == "walk":
        series = np.cumsum(white)
    elif kind == "relaxing":
        series = lfilter([1], [1, -0.9], white)
    else:
        radius = np.exp(-2 * np.pi * 0.01)
        series = lfilter([1], [1, -2 * radius * np.cos(2 * np.pi * 0.1), radius**2], white)
    own = series[-count:] - series[-count:].mean()
    return own / own.std()


def found(rows, mixing=None, time_s=None):
    """Return the noise of rows (N, R) [nT] that are mixed."""
    mixing = against_the_mean(rows.shape[1] // 3) if mixing is None else mixing
    times = STEP_S * np.arange(len(rows)) if time_s is None else time_s
    return noise_of(times, 1e-9 * rows @ mixing.T, mixing)
