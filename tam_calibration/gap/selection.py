"""Selection of the terms of an effect: forward selection and backward elimination by BIC."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from math import log
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.normal_equations import ridged
from tam_calibration.effects.term import Term
from tam_calibration.gap.regression import Numbers, Projected, twice_log_likelihood_ratio
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Selection:
    """The terms selected, and their evidence.

    Parameters
    ----------
    terms : tuple of int
        Indices of the selected terms, in the order of their listing.
    gain : float
        Energy that they explain.
    rank : int
        Degrees of freedom that they take.
    delta_bic : float
        n ln(S / (S - gain)) less the penalty of BIC and of the selection; positive speaks for them.
    """

    terms: tuple[int, ...]
    gain: float
    rank: int
    delta_bic: float


def columns_of(terms: Sequence[Term]) -> list[np.ndarray]:
    """Return the columns of each of several terms side by side."""
    ends = np.cumsum([len(term.coefficients) for term in terms])
    return [np.arange(end - len(term.coefficients), end) for end, term in zip(ends, terms, strict=True)]


def bundles_of(terms: Sequence[Term]) -> tuple[tuple[int, ...], ...]:
    """Return the groups of terms added in one step: single terms, those of one name in a sensor, or in all sensors."""
    return _bundles(tuple((term.sensor, term.axis, term.name) for term in terms))


@lru_cache
def _bundles(keys: tuple[tuple[int, int | None, str], ...]) -> tuple[tuple[int, ...], ...]:
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, (sensor, axis, name) in enumerate(keys):
        groups.setdefault((sensor, axis, name), []).append(index)
        if sensor >= 0:
            groups.setdefault((sensor, name), []).append(index)
            groups.setdefault((name,), []).append(index)
    return tuple(dict.fromkeys(tuple(group) for group in groups.values()))


@dataclass(frozen=True, eq=False)
class Choice:
    """The terms to select from, and the normal equations of all of them.

    Parameters
    ----------
    projected : Projected
        The base eliminated.
    terms : sequence of Term
        In the order of the columns.
    energy, count : float
        Residual energy before the selection, and the number of channels.
    """

    projected: Projected
    terms: Sequence[Term]
    energy: float
    count: float

    def first_step(self) -> float:
        """Return the evidence of the best single step of a selection."""
        gains, ranks = self._first
        values = evidence(self.energy, gains, self.count, ranks)
        return float(np.max(values, where=ranks > 0, initial=-np.inf))

    def select(self) -> Selection:
        """Return the terms that lower the free-scale BIC most, by stepwise selection."""
        bundles = bundles_of(self.terms)
        price = 2 * log(len(bundles))
        offers, chosen = list(bundles), list[int]()
        (gains, ranks), left = self._first, self.projected
        best, gained, spent, steps = 0.0, 0.0, 0, 0
        while True:
            values = evidence(self.energy, gained + gains, self.count, spent + ranks)
            values[ranks == 0] = -np.inf
            first = int(np.argmax(values))
            value = float(values[first]) - (steps + 1) * price
            if not np.isfinite(value) or (chosen and value <= best):
                break
            best = value
            chosen += offers[first]
            gained, spent, steps = gained + gains[first], spent + int(ranks[first]), steps + 1
            if best <= 0:
                break
            left = left.without(self._join(offers[first]))
            new_terms = dict.fromkeys(tuple(sorted(set(bundle) - set(chosen))) for bundle in bundles)
            offers = [offer for offer in new_terms if offer]
            if not offers:
                break
            gains, ranks = left.gains([self._join(offer) for offer in offers])
        return self._trimmed(sorted(chosen), steps * price)

    @cached_property
    def _columns(self) -> list[np.ndarray]:
        return columns_of(self.terms)

    @cached_property
    def _first(self) -> tuple[FloatArray, NDArray[np.intp]]:
        """Gains and ranks of all bundles."""
        return self.projected.gains([self._join(bundle) for bundle in bundles_of(self.terms)])

    def _join(self, terms: Iterable[int]) -> np.ndarray:
        return np.concatenate([self._columns[index] for index in terms])

    def _trimmed(self, chosen: list[int], price: float) -> Selection:
        """Drop terms as long as the evidence is larger without them."""
        while chosen:
            kept = self.projected.take(self._join(chosen))
            inverse, rank = kept.inverse()
            values = inverse @ kept.score
            gain = float(kept.score @ values)
            best = Selection(tuple(chosen), gain, rank, evidence(self.energy, gain, self.count, rank) - price)
            if len(chosen) == 1:
                return best
            widths = np.array([len(self._columns[index]) for index in chosen])
            lost = _lost(inverse, values, widths)
            rivals = evidence(self.energy, gain - lost, self.count, rank - np.minimum(rank, widths)) - price
            if rivals.max() <= best.delta_bic:
                return best
            del chosen[int(np.argmax(rivals))]
        return Selection((), 0.0, 0, 0.0)


def evidence(energy: float, gain: Numbers, count: float, rank: Any) -> Numbers:
    """Return n ln(S / (S - gain)) - p ln n: the free-scale BIC without the terms less that with them, for each gain.

    Parameters
    ----------
    energy : float
        Residual energy S without the terms.
    gain : float or array
        Energy that terms explain of it.
    count : float
        Number n of whitened channels.
    rank : int or array of int
        Degrees of freedom p of the terms.
    """
    price: Numbers = rank * log(count)
    return twice_log_likelihood_ratio(energy, gain, count) - price


def _lost(covariance: FloatArray, values: FloatArray, widths: np.ndarray) -> FloatArray:
    """Return the energy lost without each term, from its values and their covariance."""
    starts = np.cumsum(widths) - widths
    lost = np.zeros(len(widths))
    for width in np.unique(widths):
        terms = np.flatnonzero(widths == width)
        own = starts[terms][:, None] + np.arange(width)
        blocks = covariance[own[:, :, None], own[:, None, :]]
        size = np.sqrt(np.maximum(np.einsum("tii->ti", blocks), np.finfo(float).tiny))
        scaled = ridged(blocks / (size[:, :, None] * size[:, None, :]))
        unit = values[own] / size
        lost[terms] = np.sum(unit * np.linalg.solve(scaled, unit[:, :, None])[:, :, 0], axis=1)
    return lost
