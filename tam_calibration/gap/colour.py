"""The colour of a noise: which of white noise, slow noise and a band its spectrum needs.

The power in a band of frequencies is the model's times χ² over its degrees of freedom: Whittle's likelihood (Whittle,
J. R. Stat. Soc. B 15, 1953, p. 125). A model is a sum of shapes, w + s f^-a + b L(f), with L the density of an AR(2)
process. The variances w, s, b of greatest likelihood are found by multiplicative updates (Févotte, Bertin and Durrieu,
Neural Comput. 21, 2009, p. 793), the exponent among some, centre and width of the band by the score of all of them. A
shape is added where the Bayesian information criterion is for it by a margin. Slow noise may be an AR(1) process too,
so that it is not taken for a band; it is stated as the nearest power of the frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tam_calibration.gap.spectrum import Spectra
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
"""Part of the total power below which a white part is not determined."""


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a noise other than the white one.

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
    """Return the most likely of models with equally many parts, the white one not counted."""
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
    """Return the band of each width that has the largest score with the parts of a model eliminated."""
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
