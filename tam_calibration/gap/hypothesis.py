"""The best form of an effect: the terms selected by evidence, over its shapes, then refined; and an accepted form."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import nlargest

import numpy as np

from tam_calibration.effects.effect import Finding, LinearEffect
from tam_calibration.effects.states import Times
from tam_calibration.effects.term import Key, Term, chosen
from tam_calibration.gap.regression import Base, Choice, Selection, columns_of, twice_log_likelihood_ratio
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect, Shape
from tam_calibration.model.units import FloatArray

Place = tuple[int, int | None]
"""Sensor (index, ``SCALAR`` or ``ALL``) and axis."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect in the form with the most evidence.

    Parameters
    ----------
    effect : LinearEffect
        The effect.
    shape : Shape
        Its shape.
    terms : tuple of Term
        Those that were selected.
    selection : Selection
        Its evidence.
    tried : tuple of Shape
        The shapes among which this was the best.
    """

    effect: LinearEffect
    shape: Shape
    terms: tuple[Term, ...]
    selection: Selection
    tried: tuple[Shape, ...] = ()

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of the terms."""
        return tuple(term.key for term in self.terms)

    @property
    def searched(self) -> dict[str, list[float]]:
        """The values that were tried of each parameter of the shape of which there were several, in order."""
        values = {name: sorted({shape[name] for shape in self.tried if name in shape}) for name in self.shape}
        return {name: tried for name, tried in values.items() if len(tried) > 1}


def places_of(form: Hypothesis | Finding) -> list[Place]:
    """Return the places of a hypothesis or finding."""
    parts = form.terms if isinstance(form, Hypothesis) else form.fitted.contributions
    return list(dict.fromkeys((one.sensor, one.axis) for one in parts))


def sensors_of(places: Iterable[Place]) -> set[int]:
    """Return the sensors of places."""
    return {sensor for sensor, _ in places}


EVERYWHERE: frozenset[int] = frozenset()
"""No restriction of the sensors in which an effect may act."""


def best_form(
    base: Base, effect: LinearEffect, sensors: frozenset[int] = EVERYWHERE, times: Times = ()
) -> Hypothesis | None:
    """Return the form of an effect with the most evidence among its shapes, or None when no part of it is visible.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the terms are selected.
    effect : LinearEffect
        Its shapes are those to try at the covariates of the base.
    sensors : frozenset of int
        In which it may act, indices, ``SCALAR`` or ``ALL``; empty for everywhere.
    times : tuple of tuple of float
        At which it may come and go, seconds: of each course that a law may have.
    """
    covariates = base.channels.covariates
    at_times = (shape for own in times for shape in effect.shapes_at(own, covariates))
    shapes = (*effect.shapes(covariates, base.channels.residuals), *at_times)
    choices = ((shape, choice) for shape in shapes for choice in _choices(base, effect, shape, sensors))
    # The selection is carried out for the two with the best first step.
    promising = nlargest(2, choices, key=lambda offer: offer[1].first_step)
    selected = [(shape, choice.terms, choice.select()) for shape, choice in promising if np.isfinite(choice.first_step)]
    if not selected:
        return None
    shape, terms, selection = max(selected, key=lambda one: one[2].delta_bic)
    form = Hypothesis(effect, shape, tuple(terms[index] for index in selection.terms), selection, shapes)
    searched = [name for name in shape if effect.has_exact_shapes or len({one.get(name) for one in shapes}) > 1]
    price = len(searched) * float(np.log(base.channels.count))
    return replace(form, selection=replace(selection, delta_bic=selection.delta_bic - price))


def _choices(base: Base, effect: LinearEffect, shape: Shape, sensors: frozenset[int]) -> Iterator[Choice]:
    """Yield the terms of a shape; of each sensor apart where the effect acts on one alone."""
    terms = [
        term
        for term in base.channels.terms(effect, shape)
        if term.name not in effect.not_sought
        and (not sensors or term.sensor in sensors)
        and (term.sensor != SCALAR or effect.is_of_site or base.channels.has_scalar)
    ]
    if not terms:
        return
    projected, columns = base.project(base.channels.design(terms)), columns_of(terms)
    for apart in dict.fromkeys(term.sensor if effect.is_of_one_sensor else None for term in terms):
        own = [index for index, term in enumerate(terms) if apart in (None, term.sensor)]
        part = projected.take(np.concatenate([columns[index] for index in own]))
        yield Choice(part, [terms[index] for index in own], base.energy, base.channels.count - base.rank)


def refined(base: Base, form: Hypothesis) -> Hypothesis:
    """Return the form with the parameters of its shape moved, together, to where the chosen terms explain most.

    A direction may turn anywhere; other parameters stay between the neighbours of the best among those tried. The
    search is that of Nelder and Mead, in units of a first step: half of the way to a neighbour or, of an angle, of the
    spacing of the directions that are tried.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the terms explain energy.
    form : Hypothesis
        With the shapes that were tried; one of an effect with exact shapes stays as it is.
    """
    from scipy.optimize import minimize

    searched = {} if form.effect.has_exact_shapes else form.searched
    if not searched:
        return form
    start, step, low, high = np.transpose([_range_of(form, name, tried) for name, tried in searched.items()])

    def terms_at(steps: FloatArray) -> tuple[Shape, tuple[Term, ...]]:
        shape = {**form.shape, **dict(zip(searched, (start + step * steps).tolist(), strict=True))}
        return shape, tuple(chosen(base.channels.terms(form.effect, shape), form.keys))

    def loss(steps: FloatArray) -> float:
        return -base.project(base.channels.design(terms_at(steps)[1])).gain()[0]

    found = minimize(
        loss,
        np.zeros(len(start)),
        method="Nelder-Mead",
        bounds=np.sort([(low - start) / step, (high - start) / step], axis=0).T,
        options={
            "initial_simplex": np.vstack([np.zeros(len(start)), np.eye(len(start))]),
            "maxfev": 40,
            "xatol": 0.0125,
            "fatol": np.inf,
        },
    )
    shape, terms = terms_at(found.x)
    gains = np.array([form.selection.gain, -found.fun])
    before, after = twice_log_likelihood_ratio(base.energy, gains, base.channels.count).tolist()
    selection = replace(form.selection, gain=-found.fun, delta_bic=form.selection.delta_bic + after - before)
    return replace(form, shape=shape, terms=terms, selection=selection)


def _range_of(form: Hypothesis, name: str, tried: list[float]) -> tuple[float, float, float, float]:
    """Return start, first step, lower and upper bound of a parameter of a shape."""
    value = form.shape[name]
    if form.effect.shape_units[name] == "rad":
        return value, 0.4, -np.inf, np.inf
    here = tried.index(value)
    low, high = tried[max(here - 1, 0)], tried[min(here + 1, len(tried) - 1)]
    return value, (high - value or low - value) / 2, low, high


@dataclass(frozen=True, eq=False)
class Part:
    """An accepted effect: its shape, which of its terms, and their values (P,) in the order of the listing."""

    effect: LinearEffect
    shape: Shape
    keys: tuple[Key, ...]
    values: FloatArray

    @classmethod
    def of(cls, form: Hypothesis) -> "Part":
        """Accept a hypothesis, with values of zero to start from."""
        width = sum(len(term.coefficients) for term in form.terms)
        return cls(form.effect, form.shape, form.keys, np.zeros(width))

    @classmethod
    def at(cls, base: Base, form: Hypothesis) -> "Part":
        """Return a form with the coefficients of least squares at a null model."""
        projected = base.project(base.channels.design(form.terms))
        return replace(cls.of(form), values=projected.inverse()[0] @ projected.score)

    def terms(self, channels: WhitenedChannels) -> list[Term]:
        """Return the terms for the covariates of the channels, at all samples."""
        return chosen(self.effect.terms(channels.covariates, self.shape), self.keys)

    def left_out(self, channels: WhitenedChannels) -> list[Term]:
        """Return the terms at other places that were not selected, of the same names."""
        names = {term.name for term in self.terms(channels)}
        everywhere = () if self.effect.is_of_one_sensor else self.effect.terms(channels.covariates, self.shape)
        return [term for term in everywhere if term.name in names and term.key not in self.keys]

    def signal(self, terms: Sequence[Term], row_count: int) -> FloatArray:
        """Return what the effect adds to the rows, (N, row_count), tesla.

        Parameters
        ----------
        terms : sequence of Term
            As of ``terms``, with features at N samples.
        row_count : int
            Number of rows, 3K + 1.
        """
        total = np.zeros((len(terms[0].features), row_count))
        for term, columns in zip(terms, columns_of(terms), strict=True):
            total += term.signal(self.values[columns], row_count)
        return total

    def fitted(self, terms: Sequence[Term], covariance: FloatArray | None = None) -> FittedEffect:
        """Return the effect with its values and their standard errors.

        Parameters
        ----------
        terms : sequence of Term
            As of ``terms``, in the order of the values.
        covariance : (P, P) array, optional
            Of the values, each in the SI unit of its coefficient; zero where it does not matter.
        """
        error = np.sqrt(np.maximum(np.zeros(len(self.values)) if covariance is None else np.diag(covariance), 0))
        contributions = []
        for term, columns in zip(terms, columns_of(terms), strict=True):
            names = [coefficient.name for coefficient in term.coefficients]
            values = dict(zip(names, self.values[columns].tolist(), strict=True))
            errors = dict(zip(names, error[columns].tolist(), strict=True))
            contributions.append(Contribution(term.sensor, term.axis, term.name, values, errors))
        return FittedEffect(self.effect.name, dict(self.shape), tuple(contributions))
