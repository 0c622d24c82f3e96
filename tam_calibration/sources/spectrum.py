"""The frequency of an alternating source, found; and the band-pass that Wu 2025 takes, for comparison."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import without

_PADDING = 4
_CHANCE = 1e-3
"""Probability that noise alone makes a peak that is taken for a source."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power of all channels over frequency, and the line that stands out of it.

    Parameters
    ----------
    frequency_hz : (F,) array
        From the lowest to the highest that was searched, hertz.
    power : (F,) array
        Mean over the channels of the power over that of each channel's noise: 1 where there is noise alone.
    threshold : float
        Power above which a peak is no chance.
    peak_hz : float
        Frequency of the source.
    peak_standard_error_hz : float
        Its standard error.
    """

    frequency_hz: FloatArray
    power: FloatArray
    threshold: float
    peak_hz: float
    peak_standard_error_hz: float


def find_frequency(
    time_s: FloatArray, channels: FloatArray, background: FloatArray, lowest_hz: float, highest_hz: float
) -> Spectrum:
    """Return the spectrum of channels, and the frequency of the strongest line in it.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds; a periodogram of evenly spaced samples finds the line, and the times themselves its frequency.
    channels : (N, D) array
        Such as the readings of all axes.
    background : (N, Q) array
        Orthonormal columns that are taken off: see ``background_of``.
    lowest_hz, highest_hz : float
        Where to search.

    Raises
    ------
    InputError
        When there is nothing to search between the two, or the record is too short or too sparse.
    Refused
        When no line stands out of the noise.
    """
    from scipy.optimize import minimize_scalar
    from scipy.stats import gamma

    time, values = np.asarray(time_s, dtype=float), np.asarray(channels, dtype=float)
    frequency, power = _periodogram(time, without(background, values), lowest_hz, highest_hz)
    threshold = float(gamma.isf(_CHANCE / len(frequency), values.shape[1]) / values.shape[1])
    best = int(power.argmax())
    if power[best] < threshold:
        raise Refused(
            f"no line stands out of the noise between {lowest_hz:g} and {highest_hz:g} Hz: the strongest, at "
            f"{frequency[best]:.4g} Hz, has {power[best]:.3g} times its power, and chance reaches {threshold:.3g}"
        )
    rest = without(background, values)
    rest = rest / _line(float(frequency[best]), time, rest, background)[1]
    resolution = 1 / np.ptp(time)
    found = minimize_scalar(
        lambda value: _residual_energy(value, time, rest, background),
        bounds=(frequency[best] - 0.7 * resolution, frequency[best] + 0.7 * resolution),
        method="bounded",
        options={"xatol": 1e-9 * frequency[best]},
    )
    return Spectrum(
        frequency, power, threshold, float(found.x), _standard_error(float(found.x), time, rest, background)
    )


def _periodogram(
    time: FloatArray, rest: FloatArray, lowest_hz: float, highest_hz: float
) -> tuple[FloatArray, FloatArray]:
    count = len(time)
    even = np.linspace(time[0], time[-1], count)
    values = np.stack([np.interp(even, time, channel) for channel in rest.T], axis=1)
    frequency = np.fft.rfftfreq(_PADDING * count, even[1] - even[0])
    searched = (frequency >= lowest_hz) & (frequency <= min(highest_hz, 0.5 / (even[1] - even[0])))
    if np.ptp(time) * lowest_hz < 1 or searched.sum() < _PADDING:
        raise InputError(
            f"between {lowest_hz:g} and {highest_hz:g} Hz a record of {np.ptp(time):g} s at "
            f"{(count - 1) / np.ptp(time):g} samples per second holds no frequency: change the bounds or the record"
        )
    power = np.abs(np.fft.rfft(values * np.hanning(count)[:, None], _PADDING * count, axis=0)[searched]) ** 2
    # The median of an exponential distribution is ln 2 times its mean.
    noise = np.median(power, axis=0) / np.log(2)
    alive = noise > 0
    if not alive.any():
        raise Refused("the channels hold nothing but the background: there is no source to be found")
    return frequency[searched], (power[:, alive] / noise[alive]).mean(axis=1)


def _carrier(frequency_hz: float, time: FloatArray, background: FloatArray) -> FloatArray:
    angle = 2 * np.pi * frequency_hz * (time - time[[0, -1]].mean())
    return without(background, np.stack([np.sin(angle), np.cos(angle)], axis=1))


def _residual_energy(frequency_hz: float, time: FloatArray, rest: FloatArray, background: FloatArray) -> float:
    """Return the squares that a sinusoid leaves of all channels, each over its noise, less those before."""
    orthonormal, _ = np.linalg.qr(_carrier(frequency_hz, time, background))
    return -float(np.sum((orthonormal.T @ rest) ** 2))


def _line(
    frequency_hz: float, time: FloatArray, rest: FloatArray, background: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the amplitudes (2, D) of sine and cosine, and the noise (D,) that they leave."""
    carrier = _carrier(frequency_hz, time, background)
    amplitudes = np.linalg.lstsq(carrier, rest, rcond=None)[0]
    noise = np.sqrt(np.mean((rest - carrier @ amplitudes) ** 2, axis=0))
    return amplitudes, np.maximum(noise, 1e-12 * norm(rest, axis=0))


def _standard_error(frequency_hz: float, time: FloatArray, rest: FloatArray, background: FloatArray) -> float:
    """Return the Cramér–Rao bound of the frequency: the information of 2πf is T² N Σ (A/σ)²/24 over all channels."""
    amplitudes, noise = _line(frequency_hz, time, rest, background)
    information = np.ptp(time) ** 2 * len(time) * np.sum((amplitudes / noise) ** 2) / 24
    return float(1 / (2 * np.pi * np.sqrt(information)))


def band_pass_amplitude(time_s: FloatArray, channels: FloatArray, low_hz: float, high_hz: float) -> FloatArray:
    """Return the signed amplitudes of channels behind a band-pass of zero phase, as Wu 2025 takes them.

    A Butterworth filter of second order runs forwards and backwards; the amplitude is √2 times the root mean square of
    the middle half, in which the filter has settled, and its sign that of the correlation with the strongest channel.

    Parameters
    ----------
    time_s : (N,) array
        Times, evenly spaced, seconds.
    channels : (N, D) array
        Samples of D channels, in any unit.
    low_hz, high_hz : float
        Edges of the band.

    Returns
    -------
    (D,) array
        Peak amplitudes, in the unit of each channel.

    Raises
    ------
    InputError
        When the samples are not evenly spaced, or the band does not lie below half their rate.
    """
    from scipy.signal import butter, sosfiltfilt

    step = np.diff(time_s)
    if np.ptp(step) > 1e-3 * step.mean():
        raise InputError("a digital filter needs evenly spaced samples: demodulate instead")
    rate = 1 / float(step.mean())
    if not 0 < low_hz < high_hz < rate / 2:
        raise InputError(f"the band must lie between 0 and {rate / 2:g} Hz, not from {low_hz:g} to {high_hz:g} Hz")
    sections = butter(2, (low_hz, high_hz), btype="bandpass", fs=rate, output="sos")
    passed = sosfiltfilt(sections, channels, axis=0)[len(time_s) // 4 : 3 * len(time_s) // 4]
    size = np.sqrt(2 * np.mean(passed**2, axis=0))
    amplitude: FloatArray = size * np.sign(passed.T @ passed[:, size.argmax()])
    return amplitude
