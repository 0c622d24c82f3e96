"""The level and the colour of the noise of every axis, and whether two differ."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.colour import Colour, Shapes, colour_of
from tam_calibration.comparison.result import AxisNoise
from tam_calibration.comparison.result import Colour as ColourName
from tam_calibration.comparison.spectrum import Spectra, spectra_of
from tam_calibration.model.interpolated_noise import InterpolatedNoise
from tam_calibration.model.units import FloatArray

LEAST_DIFFERENCE = 0.05
"""Relative difference of two levels that is none in practice: sensors of one kind differ by more."""

CERTAIN = 4.5
"""Standard errors from which two noises differ: of 13 rows at 15 frequencies by chance in one of a thousand."""

_FREEDOM = 60.0
"""Degrees of freedom of neighbouring bands of two spectra that are compared as one: their ratio is nearly normal."""

_INTERVAL = 0.95
"""Probability of the interval of a density."""


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
        What readings have beside what explains them, tesla; a sample with a NaN is left out. R is 3K for the axes x, y,
        z of K sensors, or 1 for the scalar.
    mixing : (R, R) array
        Derivative of each residual by each row's noise: the identity where nothing was fitted to the other rows.
    interpolated : InterpolatedNoise, optional
        What interpolation made of the noise of the K sensors: colour and spectrum are told as they were before it.

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
    lowest, highest = (known / chdtri(known, tail) for tail in ((1 - _INTERVAL) / 2, (1 + _INTERVAL) / 2))
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


def differs(simulation: AxisNoise, recording: AxisNoise) -> bool:
    """Return whether two noises of an axis differ by more than chance, and by more than matters in practice.

    Of two white noises the standard deviations of a sample are compared as they stand, also where their rates differ.
    Else the spectra are compared at the frequencies that both have, in all and in bands of equal information: the level
    of slow noise grows with the duration, its density does not. They too are those of a sample: densities times rates.

    Parameters
    ----------
    simulation, recording : AxisNoise
        Of the same axis.
    """
    if simulation.colour == recording.colour == "white":
        ratio = np.log(recording.level_T / simulation.level_T)
        error = np.hypot(
            simulation.level_error_T / simulation.level_T,
            recording.level_error_T / recording.level_T,
        )
        more_T2 = recording.level_T**2 - simulation.level_T**2
        # Near zero the relative error of a level has no bound; the error of its square has.
        before_T2, after_T2 = (2 * noise.level_T * noise.level_error_T for noise in (simulation, recording))
        is_certain = abs(ratio) > CERTAIN * error or abs(more_T2) > CERTAIN * np.hypot(before_T2, after_T2)
        return bool(is_certain and abs(ratio) > np.log1p(LEAST_DIFFERENCE))
    (before, before_error), (after, after_error) = _powers_of_both(simulation, recording)
    group = np.cumsum(2 / (before_error**2 + after_error**2)) // _FREEDOM
    group = np.minimum(group, group[-1] - 1)
    bands = group[:, None] == np.unique(group)
    bands = np.column_stack([bands, np.ones(len(before), dtype=bool)])
    ratio = np.log((after @ bands) / (before @ bands)) / 2
    error = np.hypot(_error_of_sum(before, before_error, bands), _error_of_sum(after, after_error, bands)) / 2
    return bool(_is_beyond(ratio, error).any())


def _error_of_sum(power: FloatArray, error: FloatArray, bands: NDArray[np.bool_]) -> FloatArray:
    return np.sqrt((power * error) ** 2 @ bands) / (power @ bands)


def _is_beyond(ratio: FloatArray, error: FloatArray | float) -> NDArray[np.bool_]:
    return np.abs(ratio) > np.maximum(np.log1p(LEAST_DIFFERENCE), CERTAIN * error)


def _powers_of_both(simulation: AxisNoise, recording: AxisNoise) -> list[tuple[FloatArray, FloatArray]]:
    """Return the powers (F,) of two noises at shared frequencies, those of the coarser, and their relative errors."""
    both = simulation, recording
    low, high = max(noise.frequency_hz[0] for noise in both), min(noise.frequency_hz[-1] for noise in both)
    shared = [noise.frequency_hz[(noise.frequency_hz >= low) & (noise.frequency_hz <= high)] for noise in both]
    return [_power_at(noise, min(shared, key=len)) for noise in both]


def _power_at(noise: AxisNoise, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the power of a sample in equal parts of octaves at frequencies (F,), and its relative errors."""
    from scipy.special import ndtri

    spread = np.log(noise.density_high_T2_per_hz / noise.density_low_T2_per_hz)
    error = np.interp(frequency_hz, noise.frequency_hz, spread) / (2 * ndtri((1 + _INTERVAL) / 2))
    density = np.interp(frequency_hz, noise.frequency_hz, noise.density_T2_per_hz)
    return density * frequency_hz * noise.frequency_hz[-1], error
