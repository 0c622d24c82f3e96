"""The noise floor of every row, from differences of neighbouring samples, whatever else is in the residual.

White noise has the same power at all frequencies, while drifts, tones and spikes have little power at most frequencies
near that of Nyquist: the median of the periodogram in the upper half of the band is the level of the noise. It is taken
of the third differences of the residuals between the sensors, or of one sensor of the residual of the intensity, with
outliers clipped. How it divides among the rows follows from how each residual depends on the rows. The iteration starts
at the levels of the readings' own differences, which stay where the residuals do not determine a row.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.converter import find_lattices
from tam_calibration.effects.covariates import LEAST_TURN
from tam_calibration.effects.grades import CERTAIN, LEAST_SAMPLES, NOTABLE
from tam_calibration.effects.noise_excess import stated_noise
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.array import Array
from tam_calibration.model.units import FloatArray

CONTRADICTED = 2.0
"""Factor between noise found and noise stated, either way, from which a data sheet is contradicted.

Sheets state typical sensors, which differ by some ten per cent; a factor of two means another bandwidth or sensor.
"""


@dataclass(frozen=True, eq=False)
class Floor:
    """The noise of every row beside the rest of the residual.

    Parameters
    ----------
    level_T : (3K + 1,) array
        Standard deviation of white noise, tesla; NaN where differences do not determine it.
    colour : (3K + 1,) array
        Lag-1 correlation of the noise: 0 for white noise, towards 1 for slow noise.
    stated_T : (3K + 1,) array
        What the array file states; NaN where it does not.
    """

    level_T: FloatArray
    colour: FloatArray
    stated_T: FloatArray

    @property
    def is_determined(self) -> bool:
        """Whether the noise of all sensors is determined."""
        return bool(np.isfinite(self.level_T[:-1]).all())

    @property
    def total_T(self) -> FloatArray:
        """(3K + 1,) total standard deviation: of the AR(1) process with this colour and high-frequency level, tesla."""
        colour = np.clip(self.colour, 0, 1 - np.finfo(float).eps)
        # Power at three quarters of the Nyquist frequency over that of white noise of the same variance.
        part = (1 - colour**2) / (1 + colour**2 - 2 * colour * np.cos(0.75 * np.pi))
        return np.asarray(self.level_T / np.sqrt(part))

    def factor_common_to_all(self, sample_count: int) -> float:
        """Return the factor of most rows' noise over that stated; 1 where they do not contradict each other."""
        if not (self.is_determined and np.isfinite(self.stated_T[:-1]).all()):
            return 1.0
        rows = slice(0, -1)
        much = _middle(self.level_T[rows] / self.stated_T[rows])
        little = _middle(self.total_T[rows] / self.stated_T[rows])
        least = least_factor(sample_count)
        return much if much > least else little if little < 1 / least else 1.0


def floor_of(channels: WhitenedChannels, stated: Array) -> Floor:
    """Return the noise floor of the rows at a model.

    Parameters
    ----------
    channels : WhitenedChannels
        Whitened residuals of the model.
    stated : Array
        As the user gives it, with or without noise.
    """
    row_count = 3 * stated.sensor_count
    level, colour = np.full(row_count + 1, np.nan), np.full(row_count + 1, np.nan)
    if channels.recording.scalar_T is not None:
        known = channels.recording.scalar_T[np.isfinite(channels.recording.scalar_T)]
        if len(known) >= LEAST_SAMPLES:
            level[-1], colour[-1] = np.sqrt(_white(known)), _colour_of(known)
    is_slow = _median_turn(channels) < LEAST_TURN
    if is_slow and channels.is_counted.sum() >= LEAST_SAMPLES:
        level[:-1], colour[:-1] = _of_rows(channels, stated_noise(stated))
    return Floor(level, colour, stated_noise(stated))


def white_variance(series: FloatArray) -> tuple[float, float]:
    """Return the variance of the white noise of channels, the median of them, and its standard error; 0 without any.

    The median of m powers of white noise has the relative error 1 / (ln 2 √m), and N samples have N / 4 in the upper
    half of the band; the median of C channels has √(π / 2C) of the error of one.

    Parameters
    ----------
    series : (N, C) array
        Samples that count, of channels with noise alike.
    """
    count, width = series.shape
    if not width or count < LEAST_SAMPLES:
        return 0.0, 0.0
    variance = float(np.median([_white(one) for one in series.T]))
    return variance, variance * 2 / np.log(2) / np.sqrt(count) * min(np.sqrt(np.pi / 2 / width), 1.0)


def _of_rows(channels: WhitenedChannels, stated_T: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the levels and colours of the sensors' rows."""
    counted = channels.is_counted
    readings = channels.recording.readings_T.reshape(len(counted), -1)[counted]
    held = np.all(repeated(readings.reshape(len(readings), -1, 3)), axis=1)
    is_filled = held.mean() > NOTABLE and (~held).sum() >= LEAST_SAMPLES
    fresh = ~held if is_filled else np.ones_like(held)
    if channels.differential.size:
        mixing: FloatArray = channels.directions @ channels.directions.T
        residual: FloatArray = channels.differential[counted][fresh] @ channels.directions.T
    else:
        mixing = np.sqrt(np.mean(channels.row_direction[counted][fresh, :-1] ** 2, axis=0))[None]
        residual = channels.intensity_residual_T[counted][fresh][:, None]
    observed = np.array([_white(series) for series in residual.T])
    colour = np.array([_colour_of(series) for series in residual.T])
    variance = np.array([_white(series) for series in readings[fresh].T])
    share = mixing**2
    # Multiplicative updates towards the variances that give the observed levels; all stay positive (Lee & Seung 1999).
    for _ in range(200):
        variance = variance * (share.T @ (observed / (share @ variance))) / share.sum(axis=0)
    for lattice in find_lattices(channels.residuals):
        if lattice.row < len(variance):
            rounding = lattice.step_T**2 / 12
            noise = variance[lattice.row] - rounding
            hidden = stated_T[lattice.row] ** 2 if np.isfinite(stated_T[lattice.row]) else rounding * 1e-2
            # Noise that is only a small part of the rounding error cannot be measured.
            variance[lattice.row] = noise if noise > NOTABLE * rounding else hidden
    return np.sqrt(variance), np.broadcast_to(colour, variance.shape)


def _white(series: FloatArray) -> float:
    """Return the variance of the white noise in a series (N,) that may hold drifts, tones and spikes."""
    difference = _clipped(np.diff(series, n=3))
    power = np.abs(np.fft.rfft(difference)) ** 2 / len(difference)
    frequency = np.fft.rfftfreq(len(difference))
    upper = frequency >= 0.25
    # Half of all exponentially distributed powers lie below ln 2 times their mean.
    level = float(np.median(power[upper] / (2 * np.sin(np.pi * frequency[upper])) ** 6) / np.log(2))
    return max(level, np.finfo(float).tiny)


def _clipped(difference: FloatArray) -> FloatArray:
    """Return differences clipped at the tails of noise; unchanged where most of them are zero."""
    size = float(noise_deviation(difference))
    return np.clip(difference, -CERTAIN * size, CERTAIN * size) if size > 0 else difference


def _colour_of(series: FloatArray) -> float:
    """Return the lag-one correlation of noise in a series from its differences over one and two samples.

    Noise of the correlation φᵏ over k samples has differences of the variance 2 σ² (1 - φᵏ).
    """
    one, two = (np.mean(_clipped(series[lag:] - series[:-lag]) ** 2) for lag in (1, 2))
    return float(np.clip(two / one - 1, -1, 1)) if one > 0 else 0.0


def repeated(readings: FloatArray) -> NDArray[np.bool_]:
    """Return which samples (N, K) of sensors repeat their last reading in all axes, or lie on a line between others.

    Parameters
    ----------
    readings : (N, K, 3) array
        In any unit.
    """
    change = np.diff(readings, axis=0)
    usual = np.maximum(np.median(np.abs(change), axis=0), 1e-300)
    held = np.zeros(readings.shape[:2], dtype=bool)
    same = (np.abs(change) <= 1e-6 * usual).all(axis=2)
    held[1:] |= same
    bend = np.abs(np.diff(change, axis=0))
    on_line = (bend <= 1e-3 * usual).all(axis=2)
    held[1:-1] |= on_line & ~same[1:]
    return held


def _median_turn(channels: WhitenedChannels) -> float:
    direction = channels.direction[:, :3]
    cosine = np.sum(direction[1:] * direction[:-1], axis=1)
    return float(np.median(np.arccos(np.clip(cosine, -1, 1))))


def _middle(values: FloatArray) -> float:
    """Return the lower median: what most rows have, though a sensor of two is noisier."""
    return float(np.sort(values)[(len(values) - 1) // 2])


def least_factor(sample_count: int) -> float:
    """Return the least significant factor between two levels: the log of one is uncertain by less than 2/√N.

    Parameters
    ----------
    sample_count : int
        Samples N that a level was found from.
    """
    return float(np.exp(max(np.log(CONTRADICTED), 2 * CERTAIN / np.sqrt(max(sample_count, 1)))))
