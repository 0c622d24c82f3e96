"""The noise of every row of a recording: level, colour and spectrum."""

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from tam_calibration.gap.colour import Colour, Shapes, colour_of
from tam_calibration.gap.spectrum import Spectra, spectra_of
from tam_calibration.model.recording import InterpolatedNoise
from tam_calibration.model.units import FloatArray

ColourName = Literal["white", "1/f", "band"]

INTERVAL = 0.95
"""Probability of the interval of a density."""


@dataclass(frozen=True, eq=False)
class AxisNoise:
    """The noise of one axis of a sensor, or of the scalar: level, colour and spectrum.

    Its density is modelled as S(f) = 2 w²/r (1 + (k/f)^a) + band, with w the white level, r the sample rate, k the knee
    and a the exponent; the band has the density of an AR(2) process about its centre.

    Parameters
    ----------
    sensor : int
        Number 1…K; 0 for the scalar.
    axis : str
        "x", "y", "z"; empty for the scalar.
    level_T, level_error_T : float
        Standard deviation of all noise of a sample, and its standard error.
    colour : str
        "white", or what stands out of white noise most: "1/f" at low frequencies, "band" in a band.
    white_T : float
        Standard deviation of the white part alone.
    knee_hz, exponent : float
        Of the slow part: where it equals the white one, and how steep it is; NaN without one.
    band_hz : (float, float), optional
        Where a band lies; None without one.
    band_T : float
        Standard deviation of the band alone; 0 without one.
    stated_T : float
        Level that the array file states; NaN where it does not.
    frequency_hz : (F,) array
        Frequencies of the spectrum.
    density_T2_per_hz, density_low_T2_per_hz, density_high_T2_per_hz : (F,) array
        One-sided power spectral density, and its 95 % interval.
    """

    sensor: int
    axis: str
    level_T: float
    level_error_T: float
    colour: ColourName
    white_T: float
    knee_hz: float
    exponent: float
    band_hz: tuple[float, float] | None
    band_T: float
    stated_T: float
    frequency_hz: FloatArray = field(repr=False)
    density_T2_per_hz: FloatArray = field(repr=False)
    density_low_T2_per_hz: FloatArray = field(repr=False)
    density_high_T2_per_hz: FloatArray = field(repr=False)


def noise_of(
    time_s: FloatArray,
    residual_T: FloatArray,
    mixing: FloatArray,
    interpolated: InterpolatedNoise | None = None,
) -> tuple[AxisNoise, ...]:
    """Return the noise of each row.

    Parameters
    ----------
    time_s : (N,) array
        Increasing time stamps, seconds.
    residual_T : (N, R) array
        Readings minus what explains them, tesla; a sample with a NaN is left out. R is 3K for the axes x, y,
        z of K sensors, or 1 for the scalar.
    mixing : (R, R) array
        Derivative of each residual by each row's noise: the identity where nothing was fitted to the other rows.
    interpolated : InterpolatedNoise, optional
        What interpolation made of the noise of the K sensors: colour and spectrum are those before it.

    Raises
    ------
    InputError
        When there are too few samples.
    """
    spectra = spectra_of(time_s, residual_T, mixing)
    if interpolated is not None:
        made = np.repeat(interpolated.spectrum(spectra.frequency), 3, axis=0)
        spectra = replace(spectra, power_T2=spectra.power_T2 / made)
    shapes = Shapes(spectra)
    return tuple(_noise_of_row(spectra, shapes, row) for row in range(residual_T.shape[1]))


def _noise_of_row(spectra: Spectra, shapes: Shapes, row: int) -> AxisNoise:
    from scipy.special import chdtri

    power, freedom = spectra.power_T2[row], spectra.freedom[row]
    colour = colour_of(power, freedom, shapes)
    rate, level = 1 / spectra.step_s, float(np.sqrt(spectra.variance_T2[row]))
    share = spectra.bins / spectra.bins.sum()
    variance_error = float(np.sqrt(2 * share @ colour.power_T2**2 / freedom.sum()))
    known = np.maximum(freedom, 1)
    lowest, highest = (known / chdtri(known, tail) for tail in ((1 - INTERVAL) / 2, (1 + INTERVAL) / 2))
    density = 2 * power / rate
    is_scalar = len(spectra.power_T2) == 1
    return AxisNoise(
        sensor=0 if is_scalar else row // 3 + 1,
        axis="" if is_scalar else "xyz"[row % 3],
        level_T=level,
        level_error_T=variance_error / (2 * level),
        colour=_name_of(colour),
        white_T=float(np.sqrt(colour.white_T2)),
        knee_hz=rate * colour.knee,
        exponent=colour.slow[0].exponent if colour.slow else float("nan"),
        band_hz=_limits_hz(colour, rate),
        band_T=float(np.sqrt(colour.band[1])) if colour.band else 0.0,
        stated_T=np.nan,
        frequency_hz=rate * spectra.frequency,
        density_T2_per_hz=density,
        density_low_T2_per_hz=density * lowest,
        density_high_T2_per_hz=density * highest,
    )


def _name_of(colour: Colour) -> ColourName:
    """Return the name of the part that stands out of white noise most."""
    slow, band = (0.0 if pair is None else pair[1] for pair in (colour.slow, colour.band))
    return "white" if slow == band == 0 else "1/f" if slow >= band else "band"


def _limits_hz(colour: Colour, rate_hz: float) -> tuple[float, float] | None:
    if colour.band is None or colour.band[0].limits is None:
        return None
    low, high = colour.band[0].limits
    return rate_hz * low, rate_hz * high
