"""The level and the colour of the noise of every axis, and whether two differ.

The colour is which of white noise, slow noise and a band the spectrum needs.
The power in a band of frequencies is the model's times χ² over its degrees of freedom: Whittle's likelihood (Whittle,
J. R. Stat. Soc. B 15, 1953, p. 125). A model is a sum of shapes, w + s f^-a + b L(f), with L the density of an AR(2)
process. The variances w, s, b of greatest likelihood are found by multiplicative updates (Févotte, Bertin and Durrieu,
Neural Comput. 21, 2009, p. 793), the exponent among some, centre and width of the band by the score of all of them. A
shape is added where the Bayesian information criterion is for it by a margin. Slow noise may be an AR(1) process too,
so that it is not taken for a band; it is told as the power of the frequency that is nearest to it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.result import AxisNoise
from tam_calibration.comparison.result import Colour as ColourName
from tam_calibration.comparison.spectrum import Spectra, spectra_of
from tam_calibration.model.interpolated_noise import InterpolatedNoise
from tam_calibration.model.units import FloatArray

MARGIN = 6.0
"""Twice the log of a Bayes factor from which evidence is strong (Kass and Raftery, JASA 90, 1995, p. 773)."""

_EXPONENTS = np.arange(0.4, 2.61, 0.1)
"""Of slow noise: flicker has 1, a random walk 2, and each is uncertain by some tenths."""

_CORNERS = 0.5 / 2.0 ** np.arange(1, 9)
"""Of AR(1) processes, cycles a sample: where their density is half of that at rest; octaves below that of Nyquist."""

_HALF_WIDTHS = np.array([0.02, 0.05, 0.12, 0.3])
"""Of bands, parts of their centres: from that of a band of the spectrum to what is hardly a peak any more."""

_POINTS = 8
"""Points in a band of the spectrum at which a density is taken for its mean."""

_ROUNDS = 60
"""Multiplicative updates of the variances."""

_LEAST_PART = 1e-6
"""Of the whole power: a smaller white part cannot be told."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a noise beside the white one.

    Parameters
    ----------
    shape : (B,) array
        Its power in each band of the spectrum, of unit variance.
    exponent : float
        Of slow noise f^-a, cycles a sample; NaN of a band and of an AR(1) process.
    density : float
        The factor by which slow noise of unit variance is f^-a; else NaN.
    limits : (float, float), optional
        Frequencies at which a band has half its density; None of slow noise.
    """

    shape: FloatArray
    exponent: float = np.nan
    density: float = np.nan
    limits: tuple[float, float] | None = None

    @property
    def parameter_count(self) -> int:
        """Variance and exponent, or variance, centre and width."""
        return 2 if self.limits is None else 3


@dataclass(frozen=True, eq=False)
class Colour:
    """A model of the spectrum of one noise.

    Parameters
    ----------
    parts : tuple of Part
        Beside the white one.
    variance_T2 : (P + 1,) array
        Of the white part, and of the others.
    power_T2 : (B,) array
        In each band of the spectrum.
    deviance : float
        Twice the negative log of Whittle's likelihood, but for a constant.
    """

    parts: tuple[Part, ...]
    variance_T2: FloatArray
    power_T2: FloatArray
    deviance: float

    @property
    def white_T2(self) -> float:
        """Variance of the white part."""
        return max(float(self.variance_T2[0]), _LEAST_PART * float(self.variance_T2.sum()))

    @property
    def slow(self) -> tuple[Part, float] | None:
        """The slow part and its variance at the frequencies of the spectrum; None without one."""
        return self._first(is_band=False)

    @property
    def band(self) -> tuple[Part, float] | None:
        """The band and its variance; None without one."""
        return self._first(is_band=True)

    @property
    def knee(self) -> float:
        """Where the slow part equals the white one, cycles a sample; NaN without one."""
        if self.slow is None:
            return float("nan")
        part, variance = self.slow
        return float((variance * part.density / self.white_T2) ** (1 / part.exponent))

    def _first(self, is_band: bool) -> tuple[Part, float] | None:
        pairs = zip(self.parts, self.variance_T2[1:].tolist(), strict=True)
        return next(((part, variance) for part, variance in pairs if (part.limits is not None) == is_band), None)


class Shapes:
    """The parts that a noise may have, at the bands of a spectrum.

    Parameters
    ----------
    spectra : Spectra
        Its bands.
    """

    def __init__(self, spectra: Spectra) -> None:
        low, high = spectra.edges[:-1, None], spectra.edges[1:, None]
        at = low + (high - low) * (np.arange(_POINTS) + 0.5) / _POINTS
        share = spectra.bins / spectra.bins.sum()
        slow = np.mean(at ** -_EXPONENTS[:, None, None], axis=2)
        density = 1 / (slow @ share)
        self.slow = [
            Part(shape * factor, exponent, factor)
            for shape, factor, exponent in zip(slow, density.tolist(), _EXPONENTS.tolist(), strict=True)
        ]
        lag, turn = np.exp(-2 * np.pi * _CORNERS)[:, None, None], np.exp(-2j * np.pi * at)
        relaxing = np.mean(np.abs(1 - lag * turn) ** -2.0, axis=2)
        self.relaxing = [Part(shape / (shape @ share)) for shape in relaxing]
        centre = np.repeat(spectra.frequency[1:], len(_HALF_WIDTHS))
        half_width = centre * np.tile(_HALF_WIDTHS, len(spectra.frequency) - 1)
        pole = np.exp(-2 * np.pi * (half_width + 1j * centre))[:, None, None]
        bands = np.mean(np.abs((1 - pole * turn) * (1 - pole.conj() * turn)) ** -2.0, axis=2)
        self.band_shapes: FloatArray = bands / (bands @ share)[:, None]
        self.bands = [
            Part(shape, limits=(low, high))
            for shape, low, high in zip(
                self.band_shapes, (centre - half_width).tolist(), (centre + half_width).tolist(), strict=True
            )
        ]


def colour_of(power_T2: FloatArray, freedom: FloatArray, shapes: Shapes) -> Colour:
    """Return the model of a spectrum that the information criterion chooses.

    Parameters
    ----------
    power_T2 : (B,) array
        Spectrum of one noise.
    freedom : (B,) array
        Degrees of freedom of each.
    shapes : Shapes
        At its bands.
    """
    weight = freedom / 2

    def best(*models: tuple[Part, ...]) -> Colour:
        return _best(power_T2, weight, models)

    white, slow = best(()), best(*((part,) for part in (*shapes.slow, *shapes.relaxing)))
    with_band = [
        best(*((*model.parts, band) for band in _promising(power_T2, weight, shapes, model))) for model in (white, slow)
    ]
    each = np.log(weight.sum())
    chosen = min(
        (white, slow, *with_band),
        key=lambda model: model.deviance + sum(part.parameter_count * each + MARGIN for part in model.parts),
    )
    if chosen.slow is None:
        return chosen
    bands = tuple(part for part in chosen.parts if part.limits is not None)
    return best(*((part, *bands) for part in shapes.slow))


def _best(power: FloatArray, weight: FloatArray, models: Sequence[tuple[Part, ...]]) -> Colour:
    """Return the most likely of models with equally many parts, beside the white one."""
    white = np.ones_like(power)
    shapes = np.array([[white, *(part.shape for part in parts)] for parts in models])
    variance = np.full((len(models), 1, shapes.shape[1]), power.mean() / shapes.shape[1])
    transposed = np.swapaxes(shapes, 1, 2)
    for _ in range(_ROUNDS if shapes.shape[1] > 1 else 1):
        inverse = 1 / (variance @ shapes)
        expected = weight * inverse
        variance = variance * ((expected * inverse * power) @ transposed) / (expected @ transposed)
    model = (variance @ shapes)[:, 0]
    deviance = 2 * (power / model + np.log(model)) @ weight
    first = int(deviance.argmin())
    return Colour(models[first], variance[first, 0], model[first], float(deviance[first]))


def _promising(power: FloatArray, weight: FloatArray, shapes: Shapes, model: Colour) -> list[Part]:
    """Return the band of each width that has the largest score beside the parts of a model."""
    expected = model.power_T2
    known = np.vstack([np.ones_like(power), *(part.shape for part in model.parts)])
    precision = weight / expected**2
    shared = (shapes.band_shapes * precision) @ known.T
    taken = np.sum(shared @ np.linalg.pinv((known * precision) @ known.T, hermitian=True) * shared, axis=1)
    information = shapes.band_shapes**2 @ precision - taken
    score = shapes.band_shapes @ (precision * (power - expected))
    gain = np.divide(score, np.sqrt(np.maximum(information, 0)), out=np.zeros_like(score), where=information > 0)
    ranked = gain.reshape(-1, len(_HALF_WIDTHS))
    return [shapes.bands[int(row) * len(_HALF_WIDTHS) + width] for width, row in enumerate(ranked.argmax(axis=0))]


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
        return bool(_is_beyond(ratio, error))
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
