"""Noise of a stated spectrum for samples that arrive in batches of any size, white, slow and in a band.

Slow noise of the density 2 w²/r (k/f)^a is a sum of first-order processes whose time constants cover the frequencies
(Keshner, 1/f noise, Proc. IEEE 70, 1982, p. 212), and a band is an oscillator that white noise drives, an AR(2)
process. Both are modes z' = -λ z + white noise, with 1/λ the time constant of a process, or λ = π Δf - 2πi f of a band
about f of the width Δf. Over a step h

    z(t + h) = exp(-λ h) z(t) + k,   E |k|² = (1 - exp(-2 Re λ h)) / (2 Re λ),   E k² = (1 - exp(-2 λ h)) / (2 λ),

for white noise of unit density, so that modes keep their density whatever the steps of time are. What is read is
x = Re(c z). Its covariance over n steps is Re(G p^n), with p = exp(-λ h) = ρ exp(iθ), |c| = 1 and
G = (E |z|² + c² E z²) / 2; it is that of the AR(2) process with the poles p and p* where
tan(arg G) = -cot(θ) (1 - ρ²) / (1 + ρ²), which fixes c; for bands above a third of the rate it comes near.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.mend import NoiseTerm
from tam_calibration.effects.recursions import follow
from tam_calibration.model.recording import BLOCK
from tam_calibration.model.units import FloatArray

_PER_DECADE = 3
"""Time constants in a factor of ten: with one the density ripples by more than a fiftieth."""

_FREQUENCIES = 100
"""At which the density is fitted, equally far from each other on a logarithmic scale."""


@dataclass(frozen=True, eq=False)
class SlowModes:
    """First-order processes whose sum is slow noise.

    Parameters
    ----------
    time_constant_s : (J,) array
        Of each, seconds.
    variance_T2 : (J,) array
        Of each, T².
    """

    time_constant_s: FloatArray
    variance_T2: FloatArray


def slow_modes(term: NoiseTerm, rate_hz: float, span_s: float, most: int | None = None) -> SlowModes:
    """Return the processes whose sum has the density of a term's slow noise, none where it has none.

    Their variances are fitted by non-negative least squares to the density, as a part of that of slow and white noise
    together, from one cycle in the span to half the rate; below it the noise is flat. An exponent is 2 at most.

    Parameters
    ----------
    term : NoiseTerm
        With knee, exponent and the white noise that they are relative to.
    rate_hz : float
        Of the samples to which the white noise belongs, hertz.
    span_s : float
        Of the recording that showed the noise, seconds.
    most : int, optional
        1 for the single process that comes nearest; by default as many as it takes.
    """
    from scipy.optimize import nnls

    if np.isnan(term.knee_hz) or term.white_T == 0:
        return SlowModes(np.empty(0), np.empty(0))
    shortest = 1 / (np.pi * rate_hz)
    longest = max(span_s, 10 * shortest)
    constants = np.geomspace(shortest, longest, 1 + int(np.ceil(_PER_DECADE * np.log10(longest / shortest))))
    frequency = np.geomspace(1 / longest, rate_hz / 2, _FREQUENCIES)
    above_white = (term.knee_hz / frequency) ** term.exponent
    target = above_white / (1 + above_white)
    white = 2 * term.white_T**2 / rate_hz
    part = _density(constants, frequency, rate_hz) / (white * (1 + above_white))[:, None]
    if most == 1:
        alone = target @ part / np.sum(part**2, axis=0)
        best = int(np.argmin(np.sum((part * alone - target[:, None]) ** 2, axis=0)))
        return SlowModes(constants[[best]], alone[[best]])
    largest = part.max(axis=0)  # the fit works with numbers about 1
    weight, _ = nnls(part / largest, target)
    return SlowModes(constants[weight > 0], (weight / largest)[weight > 0])


def _density(time_constant_s: FloatArray, frequency_hz: FloatArray, rate_hz: float) -> FloatArray:
    """Return the one-sided density (F, J) of sampled first-order processes (J,) of unit variance, 1/Hz."""
    decay = np.exp(-1 / (rate_hz * time_constant_s))
    turn = np.cos(2 * np.pi * frequency_hz / rate_hz)[:, None]
    return np.asarray(2 / rate_hz * (1 - decay**2) / (1 - 2 * decay * turn + decay**2))


class NoiseStream:
    """Draws noise for samples that arrive in batches of any size; how they are split changes no number.

    Where time goes back, slow noise and bands begin anew.

    Parameters
    ----------
    terms : sequence of NoiseTerm
        What is to be added, of each row at most once.
    row_count : int
        Rows of a sample, 3K + 1: the last is the scalar's.
    rate_hz, span_s : float
        Rate and span of the recording that the terms are of, hertz and seconds.
    generator : numpy.random.Generator
        Source of the random numbers.
    """

    def __init__(
        self,
        terms: Sequence[NoiseTerm],
        row_count: int,
        rate_hz: float,
        span_s: float,
        generator: np.random.Generator,
    ) -> None:
        self._white, self._kicks = generator.spawn(2)
        self._white_T = np.zeros(row_count)
        modes: list[tuple[int, complex, float]] = []
        for term in terms:
            row = row_count - 1 if term.sensor == 0 else 3 * (term.sensor - 1) + "xyz".index(term.axis)
            self._white_T[row] = term.added_white_T
            modes += [(row, *mode) for mode in _modes(term, rate_hz, span_s)]
        self._to_rows = np.eye(row_count)[[row for row, _, _ in modes]].reshape(-1, row_count)
        self._decay = np.array([decay for _, decay, _ in modes], dtype=complex)
        self._reading = _readings_of(self._decay, rate_hz)
        unit = (0.5 / self._decay.real + (self._reading**2 * 0.5 / self._decay).real) / 2
        self._drive_T = np.sqrt(np.array([variance for _, _, variance in modes]) / unit)
        self._state = np.zeros(len(modes), complex)
        self._newest_s = np.inf

    def drawn(self, time_s: FloatArray) -> FloatArray:
        """Return the noise (N, 3K + 1) of the next samples, at times (N,) in seconds, tesla."""
        noise: FloatArray = self._white.normal(size=(len(time_s), len(self._white_T))) * self._white_T
        if len(self._decay):
            blocks = [self._coloured(time_s[start : start + BLOCK]) for start in range(0, len(time_s), BLOCK)]
            noise += np.concatenate(blocks)
        return noise

    def _coloured(self, time_s: FloatArray) -> FloatArray:
        step = np.diff(time_s, prepend=self._newest_s)[:, None]
        self._newest_s = float(time_s[-1])
        # After a pause, or where time goes back, nothing is left of a mode: its next kick makes it anew.
        exponent = np.where(step > 0, np.maximum(step, 0) * self._decay, 1e3)
        size = -np.expm1(-2 * exponent.real) / (2 * self._decay.real)
        square = -np.expm1(-2 * exponent) / (2 * self._decay)
        along, across = (np.sqrt(np.maximum(size + sign * np.abs(square), 0) / 2) for sign in (1, -1))
        drawn = self._kicks.normal(size=(*exponent.shape, 2))
        kick = self._drive_T * np.exp(0.5j * np.angle(square)) * (along * drawn[..., 0] + 1j * across * drawn[..., 1])
        modes: NDArray[np.complexfloating] = follow(kick, np.zeros_like(kick), self._state, exponent)[1:]
        self._state = modes[-1]
        return (self._reading * modes).real @ self._to_rows


def _modes(term: NoiseTerm, rate_hz: float, span_s: float) -> list[tuple[complex, float]]:
    """Return λ in 1/s and the variance in T² of each mode of a term."""
    slow = slow_modes(term, rate_hz, span_s)
    modes = list(zip(1 / slow.time_constant_s.astype(complex), slow.variance_T2, strict=True))
    if term.band_hz is not None:
        low, high = term.band_hz
        modes.append((np.pi * complex(high - low, -high - low), term.band_T**2))
    return modes


def _readings_of(decay: NDArray[np.complexfloating], rate_hz: float) -> NDArray[np.complexfloating]:
    """Return c of each mode: at the rate of the recording a band is an AR(2) process, as near as it can be."""
    turn = np.where(decay.imag == 0, np.pi / 2, -decay.imag / rate_hz)
    wanted = -np.arctan(np.tanh(decay.real / rate_hz) / np.tan(turn))
    lean = decay.real / np.abs(decay)  # of |E z²| to E |z|²
    angle = wanted + np.arcsin(np.clip(np.sin(wanted) / lean, -1, 1))
    return np.asarray(np.exp(0.5j * (angle + np.angle(decay))))
