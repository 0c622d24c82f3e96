"""Surrogate tests: how much of a residual forms explain that are like a hypothesis but unrelated to the residual."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tam_calibration.effects.effect import SurrogateKind
from tam_calibration.effects.grades import MOST, NEGLIGIBLE, SLIGHT
from tam_calibration.effects.periodic_interference import SAME_LINE
from tam_calibration.effects.term import at_rows, chosen
from tam_calibration.gap.hypothesis import Hypothesis
from tam_calibration.gap.regression import Base, columns_of, twice_log_likelihood_ratio
from tam_calibration.gap.regressors import Regressors
from tam_calibration.model.fitted_effect import SCALAR
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True)
class SurrogateTest:
    """The gain of a form compared with those of its surrogates.

    Parameters
    ----------
    gain : float
        Twice its log-likelihood ratio.
    largest : float
        The same of the best surrogate; zero where there is none.
    rank : float
        Part of the surrogates, the form among them, that explain as much: the p-value.
    """

    gain: float
    largest: float
    rank: float

    @classmethod
    def among(cls, gain: float, others: FloatArray) -> "SurrogateTest":
        """Return the test of a gain against those of surrogates.

        Parameters
        ----------
        gain : float
            Twice the log-likelihood ratio of the form.
        others : (S,) array
            The same of each surrogate; S may be 0.
        """
        largest = float(np.max(others, initial=0.0))
        return cls(gain, largest, float(1 + np.sum(others >= gain)) / (1 + len(others)))

    @property
    def ratio(self) -> float:
        """Gain over that of the best surrogate."""
        return self.gain / max(self.largest, 1.0)

    @property
    def is_matched(self) -> bool:
        """Whether some surrogate explains nearly as much: of a channel that only rises, any slow course does."""
        return self.ratio < _MATCHED


_MATCHED = 1.5
"""Gain over that of the best surrogate below which the course of the form is not what makes it explain."""


_MOVES = 150
"""Time shifts of a residual, each forwards and reversed: a rank among 300."""

_CHANNELS = 60
"""Surrogates of a recorded channel, half of them shifted in time, half with the same spectrum."""

_FREQUENCIES = 60
"""Surrogate frequencies of a tone, evenly up to half the sampling rate."""


def surrogate_test_of(base: Base, form: Hypothesis) -> SurrogateTest:
    """Return the surrogate test of a form in the residual of a base.

    It stops at the first surrogate that explains as much (sequential Monte Carlo test; Besag and Clifford, Biometrika
    78, 1991, p. 301). Motion repeats: a shift or reversal that explains the form's own signal is no surrogate, unless
    most of them do.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the form has its gain.
    form : Hypothesis
        Terms at the samples of this base; its effect tells how surrogates are made.
    """
    count = base.channels.count
    gain = base.project(base.channels.design(form.terms)).gain()[0]
    others, repeated = list[float](), list[float]()
    for explained, of_itself in _KINDS[form.effect.surrogates](base, form):
        (others if of_itself < MOST else repeated).append(explained)
        if of_itself < MOST and explained >= gain:
            break
    if len(repeated) >= len(others):
        others += repeated
    return SurrogateTest.among(
        twice_log_likelihood_ratio(base.energy, gain, count),
        twice_log_likelihood_ratio(base.energy, np.array(others), count),
    )


_Surrogates = Iterator[tuple[float, float]]
"""Of each surrogate the energy that it explains, and the part of the form's own signal that it explains."""


def _moved(base: Base, form: Hypothesis) -> _Surrogates:
    """Yield what a form explains of the residual shifted in time, forwards and reversed.

    The products of columns with the residual at every time are a cross-correlation: one Fourier transform of each
    feature and row gives them all.
    """
    design = base.channels.design(form.terms)
    projected = base.project(design)
    inverse, _ = projected.inverse()
    values = inverse @ projected.score
    own = _explained(base, design, inverse, *base.channels.taken_residual)
    of_itself = _explained(base, design, inverse, *_whitened(base, form, values))
    yield from zip(own.tolist(), (of_itself / float(projected.score @ values)).tolist(), strict=True)


def _explained(
    base: Base, design: Regressors, inverse: FloatArray, differential: FloatArray, common: FloatArray
) -> FloatArray:
    """Return the energy (S,) that columns explain of whitened residuals shifted in time, the base eliminated."""
    moved = _Shifted(base, differential, common)
    _, eliminated = base.eliminated(design)
    score = moved.scores(design) - eliminated @ np.concatenate([moved.scores(one) for one in base.designs])
    return np.asarray(np.sum(score * (inverse @ score), axis=0))


def _whitened(base: Base, form: Hypothesis, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a form with values adds to the whitened residuals of the samples that are taken."""
    channels = base.channels
    rows = np.zeros((len(form.terms[0].features), len(channels.slope)))
    for term, columns in zip(form.terms, columns_of(form.terms), strict=True):
        rows += term.signal(values[columns], rows.shape[1])
    if len(rows) != channels.slope.shape[1]:
        rows = rows[:: channels.stride]
    return rows[:, :-1] @ channels.directions, np.sum(channels.slope.T * rows, axis=1)


class _Shifted:
    """Whitened residuals of the samples that are taken, shifted in time."""

    def __init__(self, base: Base, differential: FloatArray, common: FloatArray) -> None:
        self._channels, self._count = base.channels, len(common)
        ends = SLIGHT * self._count, (1 - SLIGHT) * self._count
        self._shifts = np.unique(np.linspace(*ends, _MOVES).astype(int))
        rows = np.column_stack([differential @ base.channels.directions.T, np.zeros(self._count)])
        self._between, self._common = np.fft.rfft(rows, axis=0).T, np.fft.rfft(common)

    def scores(self, design: Regressors) -> FloatArray:
        """Return the score (P, S) of a design's columns with the shifted residuals."""
        features, _ = self._channels.samples_of(design, slice(None))
        spectrum = np.fft.rfft(features, axis=1)[design.index]
        slope = np.fft.rfft(features[design.index] * at_rows(self._channels.slope, design.rows), axis=1)
        between = at_rows(self._between, design.rows)
        forwards = spectrum * np.conj(between) + slope * np.conj(self._common)
        reversed_ = spectrum * between + slope * self._common
        return np.concatenate([self._at_shifts(design, product) for product in (forwards, reversed_)], axis=1)

    def _at_shifts(self, design: Regressors, product: np.ndarray) -> FloatArray:
        of_columns = product if design.scatter is None else design.scatter.T @ product
        return np.fft.irfft(of_columns, self._count, axis=1)[:, self._shifts]


def _of_channel(base: Base, form: Hypothesis) -> _Surrogates:
    """Yield what a form explains with its channel shifted, reversed, or drawn with the same spectrum."""
    for name in form.effect.channels:
        channel = getattr(base.channels.covariates, name)
        yield from _with_channel(base, form, name, _moved_in_time(channel))
        others = _of_spectrum(channel, _CHANNELS // 2)
        unlike = (other for other in others if abs(np.corrcoef(channel, other)[0, 1]) < 1 - NEGLIGIBLE)
        for explained, _ in _with_channel(base, form, name, unlike):
            yield explained, 0.0


def _of_attitude(base: Base, form: Hypothesis) -> _Surrogates:
    """Yield what a form explains with the attitude shifted in time against the readings."""
    attitude = base.channels.covariates.attitude
    assert attitude is not None
    yield from _with_channel(base, form, "attitude", _moved_in_time(attitude))


def _with_channel(base: Base, form: Hypothesis, name: str, others: Iterable[FloatArray]) -> _Surrogates:
    """Yield what a form explains with other courses of a channel."""
    channels = base.channels
    design = channels.design(form.terms)
    crossed, _ = base.eliminated(design)
    values = base.project(design).inverse()[0] @ base.project(design).score
    whole = float(values @ base.project(design).score)
    for other in others:
        changed: dict[str, Any] = {name: other}
        terms = chosen(form.effect.terms(replace(channels.covariates, **changed), form.shape), form.keys)
        moved = channels.design(terms)
        projected = base.project(moved)
        own = (channels.cross(moved, design) - base.eliminated(moved)[1] @ crossed) @ values
        yield projected.gain()[0], float(own @ projected.inverse()[0] @ own) / max(whole, np.finfo(float).tiny)


def _moved_in_time(channel: FloatArray) -> Iterator[FloatArray]:
    """Yield a channel (N, ...) shifted in time, forwards and reversed."""
    count = len(channel)
    for shift in np.linspace(SLIGHT * count, (1 - SLIGHT) * count, _CHANNELS // 4).astype(int):
        yield np.roll(channel, shift, axis=0)
        yield np.roll(channel[::-1], shift, axis=0)


def _of_spectrum(course: FloatArray, count: int) -> Iterator[FloatArray]:
    """Yield courses with the cosine spectrum of a given one (N,) and random signs: trends stay trends."""
    from scipy.fft import dct, idct

    generator = np.random.default_rng(0)
    spectrum = dct(course - course.mean(), norm="ortho")
    for _ in range(count):
        yield course.mean() + idct(spectrum * generator.choice([-1.0, 1.0], len(course)), norm="ortho")


def _elsewhere(base: Base, form: Hypothesis) -> _Surrogates:
    """Yield what the same functions explain in each other row."""
    covariates = base.channels.covariates
    own = {int(row) for term in form.terms for row in term.rows}
    for row in set(range(covariates.scalar_row + base.channels.has_scalar)) - own:
        sensor, axis = (SCALAR, None) if row == covariates.scalar_row else divmod(row, 3)
        terms = [replace(term, sensor=sensor, axis=axis, rows=np.full_like(term.rows, row)) for term in form.terms]
        yield base.project(base.channels.design(terms)).gain()[0], 0.0


def _at_other_frequencies(base: Base, form: Hypothesis) -> _Surrogates:
    """Yield what a tone explains at other frequencies."""
    covariates = base.channels.covariates
    span = float(np.ptp(covariates.time_s))
    own = form.shape["frequency_hz"]
    for frequency in np.linspace(0.02, 0.49, _FREQUENCIES) / covariates.step_s:
        if abs(frequency - own) * span > SAME_LINE:
            terms = chosen(form.effect.terms(covariates, {**form.shape, "frequency_hz": frequency}), form.keys)
            yield base.project(base.channels.design(terms)).gain()[0], 0.0


_KINDS: Mapping[SurrogateKind, Callable[[Base, Hypothesis], _Surrogates]] = {
    "moved": _moved,
    "of_channel": _of_channel,
    "of_attitude": _of_attitude,
    "elsewhere": _elsewhere,
    "at_other_frequencies": _at_other_frequencies,
}
