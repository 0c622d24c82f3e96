"""Least squares of regressors of the rows, with the calibration and the effects accepted before eliminated.

The terms of an effect are chosen by forward selection and backward elimination, by BIC.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import log
from typing import Any, TypeVar

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.effects.term import Term
from tam_calibration.gap.nominal import prior_at
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.units import FloatArray

Numbers = TypeVar("Numbers", float, FloatArray)

_ROUNDING = 1e-9
"""Relative size of rounding: of the information on a direction that is undetermined, as the common rotation is, and of
the energy that a fit leaves which explains all."""

VISIBLE = 1e-5
"""Part of a column's information that must remain after the calibration is eliminated."""


def _units(diagonal: FloatArray) -> FloatArray:
    """Return the units (P,) of columns; one that is zero everywhere has no part in any direction."""
    return np.where(diagonal > 0, np.sqrt(np.maximum(diagonal, 0)), np.inf)


@dataclass(frozen=True, eq=False)
class Projected:
    """Normal equations of a design with the base eliminated.

    Parameters
    ----------
    information : (P, P) array
        Schur complement of the base.
    score : (P,) array
        The same.
    before : (P,) array
        Diagonal of the information before the elimination.
    """

    information: FloatArray
    score: FloatArray
    before: FloatArray

    def take(self, columns: np.ndarray) -> "Projected":
        """Return the equations of some columns."""
        return Projected(self.information[np.ix_(columns, columns)], self.score[columns], self.before[columns])

    def without(self, columns: np.ndarray) -> "Projected":
        """Return the equations with some of their columns eliminated."""
        inverse, _ = self.take(columns).inverse()
        cross = self.information[:, columns] @ inverse
        return Projected(
            self.information - cross @ self.information[columns],
            self.score - cross @ self.score[columns],
            self.before,
        )

    def inverse(self) -> tuple[FloatArray, int]:
        """Return the inverse information within the visible directions, and how many these are."""
        values, vectors = np.linalg.eigh(self._scaled)
        kept = values > VISIBLE
        within: FloatArray = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T / np.outer(self._size, self._size)
        return within, int(kept.sum())

    def gains(self, groups: Sequence[np.ndarray]) -> tuple[FloatArray, np.ndarray]:
        """Return the energy that each group of columns explains alone, and the number of its visible directions."""
        gains, ranks = np.zeros(len(groups)), np.zeros(len(groups), dtype=int)
        scaled = self.score / self._size
        widths = np.array([len(group) for group in groups])
        for width in np.unique(widths):
            equal = np.flatnonzero(widths == width)
            columns = np.stack([groups[index] for index in equal.tolist()])
            values, vectors = np.linalg.eigh(self._scaled[columns[:, :, None], columns[:, None, :]])
            kept = values > VISIBLE
            along = np.einsum("gij,gi->gj", vectors, scaled[columns])
            gains[equal] = np.sum(np.divide(along**2, values, out=np.zeros_like(values), where=kept), axis=1)
            ranks[equal] = kept.sum(axis=1)
        return gains, ranks

    @cached_property
    def _size(self) -> FloatArray:
        return _units(self.before)

    @cached_property
    def _scaled(self) -> FloatArray:
        return self.information / np.outer(self._size, self._size)

    def gain(self) -> tuple[float, int]:
        """Return the energy that all columns together explain, and the number of their visible directions."""
        inverse, rank = self.inverse()
        return float(self.score @ inverse @ self.score), rank


class Base:
    """Normal equations of the null model: the calibration, with its prior, and the effects accepted.

    The weight of the prior grows with χ²/n of the channels, so that an unknown effect cannot push the calibration out
    of the physical bounds of sensors.

    Parameters
    ----------
    channels : WhitenedChannels
        Whitened channels.
    designs : sequence of Regressors
        Of the calibration, then of the accepted effects.

    Attributes
    ----------
    inverse : (P, P) array
        Of the information, within the directions that the data determine.
    rank : int
        Number of these directions.
    """

    def __init__(self, channels: WhitenedChannels, designs: Sequence[Regressors]) -> None:
        self.channels, self.designs = channels, tuple(designs)
        self._design = self.designs[0] if len(self.designs) == 1 else Regressors.joined(self.designs)
        information = channels.cross(self._design, self._design)
        self._score = channels.score(self._design)
        is_free = channels.has_scalar or channels.covariates.follows_attitude
        intensity_T = None if is_free else float(np.median(channels.covariates.intensity_T))
        prior = prior_at(channels.covariates.errors, intensity_T, channels.covariates.array.field)
        own = len(prior.score)
        self.prior_energy = prior.energy
        self.prior_weight = max(1.0, channels.energy / max(channels.count, 1.0))
        information[:own, :own] += self.prior_weight * prior.information
        self._score[:own] += self.prior_weight * prior.score
        white = whitening(information, _ROUNDING)
        self.inverse: FloatArray = white @ white.T
        self.rank = int(white.shape[1])
        self.step = self.inverse @ self._score
        self.information = information
        self.fall = float(self._score @ self.step)
        self.energy = max(channels.energy - self.fall, _ROUNDING * channels.energy)

    def energy_with(self, prior_weight: float) -> float:
        """Return the objective of the fit: energy of the channels and, with a weight, of the prior."""
        return self.channels.energy + prior_weight * self.prior_energy

    def project(self, design: Regressors) -> Projected:
        """Return the normal equations of a design with the base eliminated."""
        own = self.channels.cross(design, design)
        crossed = self.channels.cross(self._design, design)
        eliminated = crossed.T @ self.inverse
        return Projected(
            own - eliminated @ crossed,
            self.channels.score(design) - eliminated @ self._score,
            np.diag(own).copy(),
        )

    @cached_property
    def calibration_rank(self) -> int:
        """Number of directions that the calibration alone fits."""
        width = self.designs[0].width
        return int(whitening(self.information[:width, :width], _ROUNDING).shape[1])


def twice_log_likelihood_ratio(energy: float, gain: Numbers, count: float) -> Numbers:
    """Return n ln(S / (S - gain)), for each gain.

    Parameters
    ----------
    energy : float
        Residual energy S of the null model.
    gain : float or array
        Energy that a hypothesis explains of it.
    count : float
        Number n of whitened channels.
    """
    ratio: Numbers = count * np.log(energy / np.maximum(energy - gain, _ROUNDING * energy))
    return ratio


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
    groups: dict[tuple[object, ...], list[int]] = {}
    for index, (sensor, axis, name) in enumerate(term.key for term in terms):
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

    @property
    def first_step(self) -> float:
        """The evidence of the best single step of a selection; -∞ where nothing is visible."""
        gains, ranks = self.projected.gains([self._join(bundle) for bundle in bundles_of(self.terms)])
        values = evidence(self.energy, gains, self.count, ranks)
        return float(np.max(values, where=ranks > 0, initial=-np.inf))

    def select(self) -> Selection:
        """Return the terms that lower the free-scale BIC most, by stepwise selection."""
        bundles = bundles_of(self.terms)
        price = 2 * log(len(bundles))
        offers, chosen, left = list(bundles), list[int](), self.projected
        best, gained, spent, steps = 0.0, 0.0, 0, 0
        while offers:
            gains, ranks = left.gains([self._join(offer) for offer in offers])
            values = evidence(self.energy, gained + gains, self.count, spent + ranks)
            values[ranks == 0] = -np.inf
            # Of equal ones the first: a harmonic may have the alias of its line.
            first = int(np.argmax(values >= values.max() - _ROUNDING * np.abs(values.max())))
            value = float(values[first]) - (steps + 1) * price
            if not np.isfinite(value) or (chosen and value <= best):
                break
            best, steps = value, steps + 1
            chosen += offers[first]
            gained, spent = gained + gains[first], spent + int(ranks[first])
            if best <= 0:
                break
            left = left.without(self._join(offers[first]))
            further = dict.fromkeys(tuple(sorted(set(bundle) - set(chosen))) for bundle in bundles)
            offers = [offer for offer in further if offer]
        return self._trimmed(sorted(chosen), steps * price)

    @cached_property
    def _columns(self) -> list[np.ndarray]:
        return columns_of(self.terms)

    def _join(self, terms: Iterable[int]) -> np.ndarray:
        return np.concatenate([self._columns[index] for index in terms])

    def _trimmed(self, chosen: list[int], price: float) -> Selection:
        """Drop terms as long as the evidence is larger without them, by more than what rounding makes."""
        best = self._selection(chosen, price)
        while len(best.terms) > 1:
            fewer = [[other for other in best.terms if other != term] for term in best.terms]
            rival = max((self._selection(terms, price) for terms in fewer), key=lambda one: one.delta_bic)
            if rival.delta_bic <= best.delta_bic + _ROUNDING * abs(best.delta_bic):
                break
            best = rival
        return best

    def _selection(self, terms: Sequence[int], price: float) -> Selection:
        if not terms:
            return Selection((), 0.0, 0, 0.0)
        gain, rank = self.projected.take(self._join(terms)).gain()
        return Selection(tuple(terms), gain, rank, evidence(self.energy, gain, self.count, rank) - price)


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
