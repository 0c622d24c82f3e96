"""Noise of unit variance that is not white, (N, ...) along its first axis."""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from scipy.fft import irfft, rfft, rfftfreq
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray

Noise = Callable[[Generator, tuple[int, ...]], FloatArray]
"""Makes noise of a given shape, independent in each channel."""


def white(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return white noise."""
    return rng.normal(size=shape)


def lasting(part: float) -> Noise:
    """Return noise of which a part lasts from sample to sample: AR(1)."""

    def noise(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
        drawn = rng.normal(size=shape)
        drawn[0] /= np.sqrt(1 - part**2)
        return np.asarray(np.sqrt(1 - part**2) * lfilter([1], [1, -part], drawn, axis=0))

    return noise


def flicker(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return noise whose power falls as one over the frequency."""
    spectrum, frequency = rfft(rng.normal(size=shape), axis=0), rfftfreq(shape[0])
    frequency[0] = frequency[1]
    values = irfft(spectrum / np.sqrt(frequency).reshape(-1, *[1] * (len(shape) - 1)), shape[0], axis=0)
    return np.asarray(values / values.std(axis=0))
