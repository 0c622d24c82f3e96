"""The spectra and colours of noises that residuals mix: each residual e = M n is a known sum of independent noises n.

The spectrum is that of several sine tapers (Riedel and Sidorenko, IEEE Trans. Signal Process. 43, 1995, p. 188), which
leak so little that noise as steep as a random walk keeps its slope, averaged over bands that grow with the frequency.
In each band the cross-spectra of the residuals have the mean M diag(S) Mᵀ. The S of greatest likelihood are found by
multiplicative updates, which keep them positive; the step is the ratio of the two parts of the gradient (Févotte,
Bertin and Durrieu, Neural Comput. 21, 2009, p. 793, here for covariances). What the residuals do not tell apart, as the
two of two sensors, keeps its common start: both get the mean.

The colour of a noise is the one of white noise, slow noise and a band that its spectrum needs. The power in a band of
frequencies is the model's times χ² over its degrees of freedom: Whittle's likelihood (Whittle, J. R. Stat. Soc. B 15,
1953, p. 125). A model is a sum of shapes, w + s f^-a + b L(f), with L the density of an AR(2) process. The variances w,
s, b of greatest likelihood are found by the same updates, the exponent among some, centre and width of the band by the
score of all of them. A shape is added where the Bayesian information criterion is for it by a margin. Slow noise may be
an AR(1) process too, so that it is not taken for a band; it is stated as the nearest power of the frequency.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.grades import LEAST_SAMPLES
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray

_TAPERS = 4
"""Sine tapers: they use 8/9 of the information, and resolve five parts of one over the duration."""


_LONGEST_HOLE = 16
"""Samples of a hole that is filled with the course of the neighbours; a longer one is closed up."""


_LEAST_PART = 1e-9
"""Of the loudest row's power: the power of others is no smaller, so that covariances can be inverted."""

_NEIGHBOURS = 3
"""Bands on either side whose mean tells how certain the power in a band is."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Power of the noises of R rows in B bands. It is that of the samples: its mean over all bins is the variance.

    Parameters
    ----------
    step_s : float
        Median step of time.
    edges : (B + 1,) array
        Of the bands, cycles a sample.
    bins : (B,) array
        Independent frequencies in each band.
    power_T2 : (R, B) array
    freedom : (R, B) array
        Degrees of freedom of the power: as many as a χ² distribution with the same relative variance has.
    variance_T2 : (R,) array
        Of the samples, outliers left out.
    """

    step_s: float
    edges: FloatArray
    bins: IntArray
    power_T2: FloatArray
    freedom: FloatArray
    variance_T2: FloatArray

    @property
    def frequency(self) -> FloatArray:
        """(B,) centres of the bands, cycles a sample."""
        return (self.edges[1:] + self.edges[:-1]) / 2


def spectra_of(time_s: FloatArray, residual_T: FloatArray, mixing: FloatArray) -> Spectra:
    """Return the spectra of the noises that residuals mix.

    Parameters
    ----------
    time_s : (N,) array
        Increasing time stamps, seconds; they may jitter and have holes.
    residual_T : (N, R) array
        Tesla; a sample with a NaN is left out, and so is one with an outlier.
    mixing : (R, R) array
        Derivative of each residual by each row's noise.

    Raises
    ------
    InputError
        When fewer samples are left than tell a level.
    """
    is_finite = np.isfinite(residual_T).all(axis=1)
    if is_finite.sum() < LEAST_SAMPLES:
        raise InputError(f"the noise needs {LEAST_SAMPLES} samples without gaps, and there are {int(is_finite.sum())}")
    time, residual = time_s[is_finite], residual_T[is_finite]
    course = _course(residual)
    fits = _fits(residual - course)
    left, singular, _ = np.linalg.svd(mixing)
    independent = left[:, singular > 1e-9 * singular[0]]
    step = float(np.median(np.diff(time)))
    place = _places(time, step)
    series = _filled(place, np.where(fits[:, None], residual, course) @ independent)
    known = residual[fits] @ independent
    known -= known.mean(axis=0)
    count = series.shape[1]
    bounds, share = _bounds(count), len(known) / count
    cross = _cross_spectra(series, bounds) / share
    reduced = independent.T @ mixing
    bins = np.diff(bounds)
    information = 2 * bins * share / (1 + 1 / (2 * _TAPERS))
    return Spectra(
        step,
        (bounds - 0.5) / count,
        bins,
        _unmixed(cross, reduced).T,
        information * _certainty(cross, bins, reduced).T,
        _unmixed((known.T @ known / len(known))[None], reduced)[0],
    )


def _course(residual: FloatArray) -> FloatArray:
    """Return the running medians (N, R), which outliers do not move."""
    from scipy.ndimage import median_filter

    return np.asarray(median_filter(residual, size=(_LONGEST_HOLE + 1, 1), mode="nearest"))


def _fits(deviation: FloatArray) -> NDArray[np.bool_]:
    """Return which samples (N,) have no outlier; a row that mostly stands still has none."""
    size = noise_deviation(deviation, axis=0)
    # Normal noise lies five standard deviations off once in a million samples.
    is_outlier: NDArray[np.bool_] = (np.abs(deviation) > 5.0 * size) & (size > 0)
    return np.logical_not(is_outlier.any(axis=1))


def _places(time_s: FloatArray, step_s: float) -> IntArray:
    """Return the places (N,) of samples on a lattice of time, in which long holes are closed up."""
    steps = np.maximum(np.rint(np.diff(time_s) / step_s), 1).astype(int)
    steps[steps > _LONGEST_HOLE] = 1
    return np.concatenate([[0], np.cumsum(steps)])


def _filled(place: IntArray, values: FloatArray) -> FloatArray:
    """Return the series (r, n) on the whole lattice about their means; holes go on the course of the neighbours."""
    series = np.empty((values.shape[1], place[-1] + 1))
    series[:, place] = values.T
    holes = np.setdiff1d(np.arange(place[-1] + 1), place)
    if len(holes):
        for own, course in zip(series, _course(values).T, strict=True):
            own[holes] = np.interp(holes, place, course)
    return np.asarray(series - series.mean(axis=1, keepdims=True))


def _bounds(count: int) -> IntArray:
    """Return the first bins of the bands of a spectrum of so many samples, and the end; the mean is in none."""
    bounds, end = [1], count // 2 + 1
    # Bands are 4 % wide, where that is more than the tapers resolve.
    growth = 2 ** (1 / 16) - 1
    while end - bounds[-1] >= 2 * max(_TAPERS, growth * bounds[-1]):
        bounds.append(bounds[-1] + max(_TAPERS, round(growth * bounds[-1])))
    return np.array([*bounds, end])


def _cross_spectra(series: FloatArray, bounds: IntArray) -> FloatArray:
    """Return the mean real cross-spectra (B, r, r) of series (r, n) in bands, with the tapers' mean."""
    count = series.shape[1]
    angle = np.pi * np.arange(1, count + 1) / (count + 1)
    cross = np.zeros((len(bounds) - 1, len(series), len(series)))
    for order in range(1, _TAPERS + 1):
        taper = np.sqrt(2 / (count + 1)) * np.sin(order * angle)
        transform = np.fft.rfft(series * taper)
        for own, (start, stop) in zip(cross, pairwise(bounds), strict=True):
            band = transform[:, start:stop]
            own += (band @ band.conj().T).real
    return np.asarray(cross / (_TAPERS * np.diff(bounds)[:, None, None]))


_LEAST_POWER_T2 = 1e-60
"""Far below the noise of any magnetometer: of a channel that is constant, whose power would be zero."""


def _unmixed(cross: FloatArray, reduced: FloatArray) -> FloatArray:
    """Return the powers (B, R) of greatest likelihood of the rows' noises, from cross-spectra (B, r, r)."""
    power = np.repeat(np.trace(cross, axis1=1, axis2=2)[:, None] / np.sum(reduced**2), reduced.shape[1], axis=1)
    power = np.maximum(power, _LEAST_POWER_T2)
    for _ in range(40):
        weighted = _weighted(power, reduced)
        found = np.sum(weighted * (cross @ weighted), axis=1)
        power = power * found / np.sum(weighted * reduced, axis=1)
        power = np.maximum(power, np.maximum(_LEAST_PART * power.max(axis=1, keepdims=True), _LEAST_POWER_T2))
    return np.asarray(power)


def _weighted(power: FloatArray, reduced: FloatArray) -> FloatArray:
    """Return the inverse covariances of the residuals times the mixing, (B, r, R)."""
    covariance = (reduced * power[:, None]) @ reduced.T
    return np.linalg.solve(covariance, np.broadcast_to(reduced, (len(power), *reduced.shape)))


def _certainty(cross: FloatArray, bins: IntArray, reduced: FloatArray) -> FloatArray:
    """Return by which factor (B, R) the information on a row's power is that of a noise that stands alone."""
    summed = np.cumsum(np.concatenate([np.zeros_like(cross[:1]), cross * bins[:, None, None]]), axis=0)
    first = np.maximum(np.arange(len(bins)) - _NEIGHBOURS, 0)
    last = np.minimum(np.arange(len(bins)) + _NEIGHBOURS + 1, len(bins))
    power = _unmixed(summed[last] - summed[first], reduced)
    shared = (np.swapaxes(_weighted(power, reduced), 1, 2) @ reduced) ** 2
    information = shared * power[:, :, None] * power[:, None]
    variance = np.diagonal(np.linalg.pinv(information, rcond=_LEAST_PART, hermitian=True), axis1=1, axis2=2)
    return 1 / np.maximum(variance, 1.0)


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
    variance_T2 : float
        That was fitted.
    """

    shape: FloatArray
    exponent: float = np.nan
    density: float = np.nan
    limits: tuple[float, float] | None = None
    variance_T2: float = 0.0


@dataclass(frozen=True, eq=False)
class Colour:
    """A model of the spectrum of one noise.

    Parameters
    ----------
    white_T2 : float
        Variance of the white part; a millionth of all where it is not determined.
    slow, band : Part, optional
        The other parts.
    power_T2 : (B,) array
        In each band of the spectrum.
    deviance : float
        Twice the negative log of Whittle's likelihood, but for a constant.
    """

    white_T2: float
    slow: Part | None
    band: Part | None
    power_T2: FloatArray
    deviance: float

    @property
    def parts(self) -> tuple[Part, ...]:
        """All but the white one."""
        return tuple(part for part in (self.slow, self.band) if part is not None)

    @property
    def knee(self) -> float:
        """Where the slow part equals the white one, cycles a sample; NaN without one."""
        if self.slow is None:
            return float("nan")
        return float((self.slow.variance_T2 * self.slow.density / self.white_T2) ** (1 / self.slow.exponent))


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
        known = zip(slow * density[:, None], _EXPONENTS.tolist(), density.tolist(), strict=True)
        self.slow = [Part(shape, exponent, factor) for shape, exponent, factor in known]
        lag, turn = np.exp(-2 * np.pi * _CORNERS)[:, None, None], np.exp(-2j * np.pi * at)
        relaxing = np.mean(np.abs(1 - lag * turn) ** -2.0, axis=2)
        self.relaxing = [Part(shape / (shape @ share)) for shape in relaxing]
        centre = np.repeat(spectra.frequency[1:], len(_HALF_WIDTHS))
        half_width = centre * np.tile(_HALF_WIDTHS, len(spectra.frequency) - 1)
        pole = np.exp(-2 * np.pi * (half_width + 1j * centre))[:, None, None]
        bands = np.mean(np.abs((1 - pole * turn) * (1 - pole.conj() * turn)) ** -2.0, axis=2)
        self.band_shapes: FloatArray = bands / (bands @ share)[:, None]
        limits = zip((centre - half_width).tolist(), (centre + half_width).tolist(), strict=True)
        self.bands = [Part(shape, limits=each) for shape, each in zip(self.band_shapes, limits, strict=True)]


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
        key=lambda model: (
            model.deviance + sum((2 if part.limits is None else 3) * each + MARGIN for part in model.parts)
        ),
    )
    if chosen.slow is None:
        return chosen
    return best(*((part,) if chosen.band is None else (part, chosen.band) for part in shapes.slow))


def _best(power: FloatArray, weight: FloatArray, models: Sequence[tuple[Part, ...]]) -> Colour:
    """Return the most likely of models with equally many parts, the white one not counted."""
    white = np.ones_like(power)
    shapes = np.array([[white, *(part.shape for part in parts)] for parts in models])
    variance = np.full((len(models), 1, shapes.shape[1]), power.mean() / shapes.shape[1])
    transposed = np.swapaxes(shapes, 1, 2)
    for _ in range(60 if shapes.shape[1] > 1 else 1):
        inverse = 1 / (variance @ shapes)
        expected = weight * inverse
        variance = variance * ((expected * inverse * power) @ transposed) / (expected @ transposed)
    model = (variance @ shapes)[:, 0]
    deviance = 2 * (power / model + np.log(model)) @ weight
    first = int(deviance.argmin())
    of_white, *others = variance[first, 0].tolist()
    parts = [replace(part, variance_T2=one) for part, one in zip(models[first], others, strict=True)]
    slow, band = (next((one for one in parts if (one.limits is None) == is_slow), None) for is_slow in (True, False))
    return Colour(max(of_white, 1e-6 * sum([of_white, *others])), slow, band, model[first], float(deviance[first]))


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
