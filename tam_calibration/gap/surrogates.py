"""How much of a residual a form would explain if it had nothing to do with it: how it stands among its surrogates."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tam_calibration.effects.effect import SurrogateKind
from tam_calibration.effects.grades import MOST, NEGLIGIBLE, SLIGHT
from tam_calibration.effects.periodic_interference import SAME_LINE
from tam_calibration.effects.term import Term, chosen
from tam_calibration.gap.hypothesis import Hypothesis
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.selection import columns_of
from tam_calibration.model.fitted_effect import SCALAR
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True)
class SurrogateTest:
    """How a form stands among its surrogates.

    Parameters
    ----------
    gain : float
        Twice the logarithm of its likelihood ratio.
    largest : float
        The same of the best surrogate; zero where there is none.
    rank : float
        Part of the surrogates, itself among them, that explain as much.
    """

    gain: float
    largest: float
    rank: float

    @classmethod
    def among(cls, gain: float, others: FloatArray) -> "SurrogateTest":
        """Return the standing of a gain among others (S,)."""
        largest = float(np.max(others, initial=0.0))
        return cls(gain, largest, float(1 + np.sum(others >= gain)) / (1 + len(others)))

    @property
    def ratio(self) -> float:
        """How many times the best surrogate's gain."""
        return self.gain / max(self.largest, 1.0)


_MOVES = 150
"""Times by which a residual is moved, forwards and reversed: a rank among 300."""

_CHANNELS = 60
"""Channels that are made of a recorded one, half of them moved, half of the same spectrum."""

_FREQUENCIES = 60
"""At which a tone is set instead, evenly up to half the sampling rate."""


def surrogate_test_of(base: Base, form: Hypothesis) -> SurrogateTest:
    """Return how a form stands among its surrogates in the residual of a base.

    No more surrogates are made once one explains as much: its rank is then told (sequential Monte Carlo test; Besag and
    Clifford, Biometrika 78, 1991, p. 301).
    """
    count = base.channels.count
    gain = base.project(base.channels.design(form.terms)).gain()[0]
    others: list[float] = []
    for explained in _KINDS[form.effect.surrogates](base, form):
        others.append(explained)
        if explained >= gain:
            break
    return SurrogateTest.among(
        twice_log_likelihood_ratio(base.energy, gain, count),
        twice_log_likelihood_ratio(base.energy, np.array(others), count),
    )


def _moved(base: Base, form: Hypothesis) -> Iterator[float]:
    """Yield what a form explains of the residual moved in time, forwards and reversed.

    The products of columns with the residual at every time are a cross-correlation: one Fourier transform of each
    feature and row gives them all.
    """
    design = base.channels.design(form.terms)
    projected = base.project(design)
    inverse, _ = projected.inverse()
    values = inverse @ projected.score
    own = _explained(base, design, inverse, *base.channels.taken_residual)
    of_itself = _explained(base, design, inverse, *_whitened(base, form, values))
    # Motion repeats: what a form explains of itself, moved, is no surrogate, unless it always explains as much.
    is_other = of_itself < MOST * float(projected.score @ values)
    yield from own[is_other] if is_other.mean() > MOST else own


def _explained(
    base: Base, design: Regressors, inverse: FloatArray, differential: FloatArray, common: FloatArray
) -> FloatArray:
    """Return the energy (S,) that columns explain of whitened residuals moved in time, the base eliminated."""
    moved = _Moved(base, differential, common)
    _, eliminated = base.eliminated(design)
    score = moved.scores(design) - eliminated @ np.concatenate([moved.scores(one) for one in base.designs])
    explained: FloatArray = np.sum(score * (inverse @ score), axis=0)
    return explained


def _whitened(base: Base, form: Hypothesis, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what a form with values adds to the whitened residuals of the samples that are taken."""
    channels = base.channels
    rows = np.zeros((len(form.terms[0].features), len(channels.slope)))
    for term, columns in zip(form.terms, columns_of(form.terms), strict=True):
        rows += term.signal(values[columns], rows.shape[1])
    if len(rows) != channels.slope.shape[1]:
        rows = rows[:: channels.stride]
    return rows[:, :-1] @ channels.directions, np.sum(channels.slope.T * rows, axis=1)


class _Moved:
    """Whitened residuals of the samples that are taken, moved in time."""

    def __init__(self, base: Base, differential: FloatArray, common: FloatArray) -> None:
        self._channels, self._count = base.channels, len(common)
        ends = SLIGHT * self._count, (1 - SLIGHT) * self._count
        self._shifts = np.unique(np.linspace(*ends, _MOVES).astype(int))
        rows = np.column_stack([differential @ base.channels.directions.T, np.zeros(self._count)])
        self._between, self._common = np.fft.rfft(rows, axis=0).T, np.fft.rfft(common)

    def scores(self, design: Regressors) -> FloatArray:
        """Return the score (P, S) of a design's columns in the moved residuals."""
        features, _ = self._channels.seen(design, slice(None))
        spectrum = np.fft.rfft(features, axis=1)[design.index]
        slope = np.fft.rfft(features[design.index] * self._channels.slope[design.rows], axis=1)
        between = self._between[design.rows]
        forwards = spectrum * np.conj(between) + slope * np.conj(self._common)
        reversed_ = spectrum * between + slope * self._common
        return np.concatenate([self._at_shifts(design, product) for product in (forwards, reversed_)], axis=1)

    def _at_shifts(self, design: Regressors, product: np.ndarray) -> FloatArray:
        of_columns = product if design.scatter is None else design.scatter.T @ product
        score: FloatArray = np.fft.irfft(of_columns, self._count, axis=1)[:, self._shifts]
        return score


def _of_channel(base: Base, form: Hypothesis) -> Iterator[float]:
    """Yield what a form explains with its channel moved, reversed, or replaced by another of the same spectrum."""
    covariates = base.channels.covariates
    for name in form.effect.channels:
        channel = getattr(covariates, name)
        for other in (*_moved_in_time(channel), *_of_spectrum(channel, _CHANNELS // 2)):
            if abs(np.corrcoef(channel, other)[0, 1]) < 1 - NEGLIGIBLE:
                changed: dict[str, Any] = {name: other}
                yield _explained_by(base, form.effect.terms(replace(covariates, **changed), form.shape), form)


def _of_attitude(base: Base, form: Hypothesis) -> Iterator[float]:
    """Yield what a form explains with the attitude moved against what the sensors read."""
    covariates = base.channels.covariates
    assert covariates.attitude is not None
    for other in _moved_in_time(covariates.attitude):
        yield _explained_by(base, form.effect.terms(replace(covariates, attitude=other), form.shape), form)


def _moved_in_time(channel: FloatArray) -> Iterator[FloatArray]:
    """Yield a channel (N, ...) moved in time, forwards and reversed."""
    count = len(channel)
    for shift in np.linspace(SLIGHT * count, (1 - SLIGHT) * count, _CHANNELS // 4).astype(int):
        yield np.roll(channel, shift, axis=0)
        yield np.roll(channel[::-1], shift, axis=0)


def _of_spectrum(course: FloatArray, count: int) -> Iterator[FloatArray]:
    """Yield courses of time with the cosine spectrum of another (N,), the signs drawn: trends stay what they are."""
    from scipy.fft import dct, idct

    generator = np.random.default_rng(0)
    spectrum = dct(course - course.mean(), norm="ortho")
    for _ in range(count):
        yield course.mean() + idct(spectrum * generator.choice([-1.0, 1.0], len(course)), norm="ortho")


def _elsewhere(base: Base, form: Hypothesis) -> Iterator[float]:
    """Yield what the same functions explain in each other row."""
    covariates = base.channels.covariates
    own = {int(row) for term in form.terms for row in term.rows}
    for row in set(range(covariates.scalar_row + base.channels.has_scalar)) - own:
        sensor, axis = (SCALAR, None) if row == covariates.scalar_row else divmod(row, 3)
        terms = [replace(term, sensor=sensor, axis=axis, rows=np.full_like(term.rows, row)) for term in form.terms]
        yield base.project(base.channels.design(terms)).gain()[0]


def _at_other_frequencies(base: Base, form: Hypothesis) -> Iterator[float]:
    """Yield what a tone explains at other frequencies."""
    covariates = base.channels.covariates
    span = float(np.ptp(covariates.time_s))
    own = form.shape["frequency_hz"]
    for frequency in np.linspace(0.02, 0.49, _FREQUENCIES) / covariates.step_s:
        if abs(frequency - own) * span > SAME_LINE:
            yield _explained_by(base, form.effect.terms(covariates, {**form.shape, "frequency_hz": frequency}), form)


def _explained_by(base: Base, terms: Iterable[Term], form: Hypothesis) -> float:
    """Return the energy that those of an effect's terms explain that a form has."""
    return base.project(base.channels.design(chosen(terms, form.keys))).gain()[0]


_KINDS: Mapping[SurrogateKind, Callable[[Base, Hypothesis], Iterator[float]]] = {
    "moved": _moved,
    "of_channel": _of_channel,
    "of_attitude": _of_attitude,
    "elsewhere": _elsewhere,
    "at_other_frequencies": _at_other_frequencies,
}
