"""Noise that is no white noise of the stated level, and the levels that were drawn."""

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_validation.blind.disturbance import Signal

_SETTLING = 500
"""Samples that a resonance of quality 10 at a twelfth of the rate needs to forget how it began, and more."""


def louder(rng: Generator, noise: Signal, where: str) -> Signal:
    """Return noise whose level is 1.3 to 3 times as large in all sensors, or in one."""
    chosen = slice(None) if where == "all" else int(rng.integers(noise[0].shape[1]))
    vectors = noise[0].copy()
    vectors[:, chosen] *= rng.uniform(1.3, 3)
    return vectors, noise[1]


def coloured(rng: Generator, noise: Signal, colour: str) -> Signal:
    """Return noise with a part beside it in all axes, 1/f or in a band, of the white part's variance or more."""
    share = np.sqrt(rng.uniform(1, 3))
    vectors = noise[0]
    part = pink(rng, vectors.shape) if colour == "1/f" else band(rng, vectors.shape)
    return vectors + share * vectors.std() * part, noise[1]


def pink(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return noise (N, …) of a density that falls as 1/f, of unit variance over the run."""
    spectrum = np.fft.rfft(rng.normal(size=shape), axis=0)
    order = np.arange(1, len(spectrum)).reshape(-1, *[1] * (len(shape) - 1))
    spectrum[1:] /= np.sqrt(order)
    spectrum[0] = 0
    values = np.fft.irfft(spectrum, shape[0], axis=0)
    return np.asarray(values / values.std())


def band(rng: Generator, shape: tuple[int, ...]) -> FloatArray:
    """Return noise (N, …) of a resonance, an AR(2) process of quality 5 to 10, of unit variance over the run."""
    center, quality = rng.uniform(0.08, 0.4), rng.uniform(5, 10)
    pole = np.exp(-np.pi * center / quality)
    driven = rng.normal(size=(shape[0] + _SETTLING, *shape[1:]))
    feedback = [1.0, -2 * pole * np.cos(2 * np.pi * center), pole**2]
    values = lfilter([1.0], feedback, driven, axis=0)[_SETTLING:]
    return np.asarray(values / values.std())


def levels_nT(noise: Signal) -> list[float]:
    """Return the standard deviations of the noise that was drawn, axis by axis, last that of the scalar."""
    deviations = np.append(noise[0].std(axis=0).ravel(), noise[1].std())
    return [float(level) for level in to_nanotesla(deviations)]
