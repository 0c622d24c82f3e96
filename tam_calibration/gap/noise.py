"""The noise of every row of a recording, and what it says of the noise that the array file states."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from numpy.linalg import lstsq

from tam_calibration.core.least_squares import Elimination
from tam_calibration.effects.grades import SLIGHT
from tam_calibration.effects.noise_excess import stated_noise
from tam_calibration.effects.removal import agreed_field
from tam_calibration.gap.floor import least_factor, white_variance
from tam_calibration.gap.model import Model
from tam_calibration.gap.regressors import products_of
from tam_calibration.gap.spectrum import Colour, Shapes, Spectra, colour_of, spectra_of
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import InterpolatedNoise, Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, rounded, to_nanotesla

ColourName = Literal["white", "1/f", "band"]


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
    lowest, highest = (known / chdtri(known, tail) for tail in (SLIGHT / 2, 1 - SLIGHT / 2))
    density = 2 * power / rate
    is_scalar = len(spectra.power_T2) == 1
    limits = None if colour.band is None else colour.band.limits
    return AxisNoise(
        sensor=0 if is_scalar else row // 3 + 1,
        axis="" if is_scalar else "xyz"[row % 3],
        level_T=level,
        level_error_T=variance_error / (2 * level),
        colour=_name_of(colour),
        white_T=colour.white_T2**0.5,
        knee_hz=rate * colour.knee,
        exponent=colour.slow.exponent if colour.slow else float("nan"),
        band_hz=(rate * limits[0], rate * limits[1]) if limits else None,
        band_T=colour.band.variance_T2**0.5 if colour.band else 0.0,
        stated_T=np.nan,
        frequency_hz=rate * spectra.frequency,
        density_T2_per_hz=density,
        density_low_T2_per_hz=density * lowest,
        density_high_T2_per_hz=density * highest,
    )


def _name_of(colour: Colour) -> ColourName:
    """Return the name of the part that stands out of white noise most."""
    slow, band = (0.0 if part is None else part.variance_T2 for part in (colour.slow, colour.band))
    return "white" if slow == band == 0 else "1/f" if slow >= band else "band"


def recorded_noise(model: Model, stated: Array) -> tuple[AxisNoise, ...]:
    """Return the noise of each axis, last that of the scalar where there is one; nothing of too few samples.

    Parameters
    ----------
    model : Model
        With the causes. White noise that is a cause has the level of the cause.
    stated : Array
        As it was given, with or without noise.
    """
    time_s, quiet = model.recording.time_s, model.quiet()
    try:
        noise = noise_of(time_s, *residual_of(model, quiet), quiet.interpolated_noise)
    except InputError:
        return ()
    if quiet.scalar_T is not None:
        noise += _noise_of_scalar(time_s[model.is_counted], quiet.scalar_T[model.is_counted])
    excess_T2 = sum(one.variance for one in model.findings if one.variance is not None)
    rows = np.column_stack(np.broadcast_arrays(stated_noise(stated), stated_noise(model.array) ** 2, excess_T2))
    return tuple(_stated(one, len(time_s), *row) for one, row in zip(noise, rows.tolist(), strict=False))


def _stated(noise: AxisNoise, count: int, stated_T: float, floor_T2: float, excess_T2: float) -> AxisNoise:
    """Return a noise with what is stated of it; white noise that is a cause at the level that all samples give it."""
    noise = replace(noise, stated_T=stated_T)
    if excess_T2 == 0 or noise.colour != "white":
        return noise
    level_T = float(np.sqrt(floor_T2 + excess_T2))
    return replace(noise, level_T=level_T, white_T=level_T, level_error_T=level_T / float(np.sqrt(2 * count)))


def _noise_of_scalar(time_s: FloatArray, scalar_T: FloatArray) -> tuple[AxisNoise, ...]:
    """Return the noise of the scalar: white, as what is slow in its readings is the field itself; none of too few."""
    known = np.isfinite(scalar_T)
    variance_T2, error_T2 = white_variance(scalar_T[known, None])
    if variance_T2 == 0:
        return ()
    level_T = float(np.sqrt(variance_T2))
    (noise,) = noise_of(time_s[known], scalar_T[known, None], np.eye(1))
    white = replace(noise, colour="white", knee_hz=np.nan, exponent=np.nan, band_hz=None, band_T=0.0)
    return (replace(white, level_T=level_T, level_error_T=error_T2 / (2 * level_T), white_T=level_T),)


def residual_of(model: Model, quiet: Recording) -> tuple[FloatArray, FloatArray]:
    """Return what a model leaves of the readings, and how it mixes the noise of the rows.

    The field of a sample is that on which the sensors agree; of one sensor that of the recorded attitude or, without
    one, its intensity alone.

    Parameters
    ----------
    model : Model
        Of N samples and K sensors; samples that it excludes are NaN.
    quiet : Recording
        The same samples without what effects add.

    Returns
    -------
    residual : (N, 3K) array
        Tesla.
    mixing : (3K, 3K) array
        M of e = M n, the residual of the noise n of the rows.
    """
    errors = model.errors
    count, row_count = quiet.sensor_count, 3 * quiet.sensor_count
    mixing = np.eye(row_count)
    if count > 1:
        unmixing = Elimination.of_sensors(errors, model.array.vector_noise_T).unmixing
        mixing -= errors.matrix.reshape(row_count, 3) @ unmixing
    if count > 1 or model.world is not None:
        left = quiet.readings_T - errors.distort(field_of(errors, model.array, quiet, model))
        residual = left.reshape(quiet.sample_count, row_count)
    else:
        intensity_T = np.linalg.norm(errors.restore(quiet.readings_T)[:, 0], axis=1)
        known_T = model.intensity_T if quiet.scalar_T is None else quiet.scalar_T
        residual = np.repeat((intensity_T - known_T)[:, None], row_count, axis=1)
    residual[~model.is_counted] = np.nan
    return residual, mixing


def field_of(errors: SensorErrors, array: KnownNoiseArray, quiet: Recording, model: Model) -> FloatArray:
    """Return the field (N, 3) on which sensors agree; of one sensor that of the attitude, where it is known; tesla.

    Parameters
    ----------
    errors : SensorErrors
        Of a calibration.
    array : KnownNoiseArray
        Of the same sensors.
    quiet : Recording
        N samples without what effects add.
    model : Model
        Of the same samples.
    """
    if model.world is None:
        return agreed_field(quiet.readings_T, errors, array)
    assert model.recording.attitude is not None
    products = products_of(model.recording.attitude)
    smooth_T = products @ lstsq(products, quiet.readings_T[:, 0], rcond=None)[0]
    return errors.restore(smooth_T[:, None])[:, 0]


def remarks_on(noise: Sequence[AxisNoise], array: Array, is_determined: bool, sample_count: int) -> tuple[str, ...]:
    """Return what the noise found says of the noise that the array states, in sentences.

    Parameters
    ----------
    noise : sequence of AxisNoise
        Of each axis.
    array : Array
        As it was given, with or without noise.
    is_determined : bool
        Whether differences of neighbouring samples determine the noise of the sensors.
    sample_count : int
        Samples that it was found from.
    """
    if not is_determined:
        if array.vector_noise_T is not None:
            return ()
        return (
            "The noise is not stated, and the attitude changes so much from sample to sample that no differences tell "
            "it: it is taken from the residual, so that nothing white can be called a gap.",
        )
    white, whole = (_by_sensor([getattr(one, name) for one in noise if one.sensor]) for name in ("white_T", "level_T"))
    if array.vector_noise_T is None:
        named = ", ".join(f"{_nT(one)} of sensor {sensor}" for sensor, one in enumerate(white, start=1))
        return (
            f"The noise is not stated: {named} {'is' if len(white) == 1 else 'are'} taken from the recording, so that "
            "nothing white can be called a gap.",
        )
    least = least_factor(sample_count)
    return tuple(
        f"The stated noise of sensor {sensor} is contradicted: stated {_nT(sheet)}, found {_nT(found)}."
        for sensor, (sheet, *both) in enumerate(zip(array.vector_noise_T, white, whole, strict=False), start=1)
        for found in ([both[0]] if both[0] > least * sheet else [both[1]] if both[1] < sheet / least else [])
    )


def _by_sensor(rows_T: Sequence[float]) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(np.reshape(rows_T, (-1, 3)) ** 2, axis=1)))


def _nT(value_T: float) -> str:
    return f"{rounded(to_nanotesla(float(value_T)), 3)} nT"
