"""The best form of one hypothesis: over the shapes of an effect, the terms that the data ask for."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from heapq import nlargest

import numpy as np

from tam_calibration.effects.effect import SCALAR, Finding, FittedEffect, LinearEffect, Shape, Situation, Term
from tam_calibration.effects.term import Key, chosen
from tam_calibration.gap.regression import Base
from tam_calibration.gap.selection import Choice, Selection, columns_of, evidence
from tam_calibration.units import FloatArray

_FULLY_SELECTED = 2
"""Shapes, the most promising ones, of which the terms are selected."""

Place = tuple[int, int | None]
"""Sensor (index, ``SCALAR`` or ``ALL``) and axis."""


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """An effect in the form in which it explains most.

    Parameters
    ----------
    effect : LinearEffect
        The effect.
    shape : Shape
        Its shape.
    terms : tuple of Term
        What was selected of it.
    selection : Selection
        Its evidence.
    tried : tuple of Shape
        The shapes among which this was the best.
    values : (P,) array, optional
        Coefficients to start from, where the fit does not find them from zero.
    """

    effect: LinearEffect
    shape: Shape
    terms: tuple[Term, ...]
    selection: Selection
    tried: tuple[Shape, ...] = ()
    values: FloatArray | None = None

    def moved(self, situation: Situation) -> "Hypothesis":
        """Return the same terms of the same shape in another situation, at all of its samples."""
        return replace(self, terms=tuple(chosen(self.effect.terms(situation, self.shape), self.keys)))

    @property
    def keys(self) -> tuple[Key, ...]:
        """Of the terms."""
        return tuple(term.key for term in self.terms)

    @property
    def width(self) -> int:
        """Number of coefficients P."""
        return sum(len(term.coefficients) for term in self.terms)


def places_of(form: Hypothesis | Finding) -> list[Place]:
    """Return the places of a hypothesis or finding."""
    if isinstance(form, Hypothesis):
        return list(dict.fromkeys((term.sensor, term.axis) for term in form.terms))
    return list(dict.fromkeys((one.sensor, one.axis) for one in form.fitted.contributions))


def sensors_of(places: Iterable[Place]) -> set[int]:
    """Return the sensors of places."""
    return {sensor for sensor, _ in places}


def best_form(base: Base, effect: LinearEffect) -> Hypothesis | None:
    """Return the form of an effect with the most evidence among its shapes, or None when no part of it is visible."""
    shapes = tuple(effect.shapes(base.channels.situation, base.channels.misfit))
    offers = (offer for shape in shapes for offer in _offers(base, effect, shape))
    promising = nlargest(_FULLY_SELECTED, offers, key=lambda offer: offer.evidence)
    selected = (_selected(effect, offer) for offer in promising)
    forms = [form for form in selected if form is not None]
    if not forms:
        return None
    best = replace(max(forms, key=lambda form: form.selection.delta_bic), tried=shapes)
    price = _searched(best) * float(np.log(base.channels.count))
    return replace(best, selection=replace(best.selection, delta_bic=best.selection.delta_bic - price))


def _searched(form: Hypothesis) -> int:
    """Return the number of parameters of a shape that were searched, not a convention."""
    if form.effect.has_exact_shapes:
        return len(form.shape)
    return sum(len({other.get(name) for other in form.tried}) > 1 for name in form.shape)


def given_form(base: Base, effect: LinearEffect, fitted: FittedEffect) -> Hypothesis:
    """Return an effect with known shape and coefficients as a form."""
    wanted = {(one.sensor, one.axis, one.term): one for one in fitted.contributions}
    terms = [
        term for term in base.channels.terms(effect, fitted.shape) if (term.sensor, term.axis, term.name) in wanted
    ]
    values = [
        wanted[term.sensor, term.axis, term.name].values.get(coefficient.name, 0.0)
        for term in terms
        for coefficient in term.coefficients
    ]
    gain, rank = base.project(base.channels.design(terms)).gain()
    selection = Selection(tuple(range(len(terms))), gain, rank, evidence(base.energy, gain, base.channels.count, rank))
    return Hypothesis(effect, fitted.shape, tuple(terms), selection, (), np.array(values))


def restricted(base: Base, form: Hypothesis, sensor: int) -> Hypothesis | None:
    """Return what the data ask for of the same effect and shape at one sensor."""
    offers = list(_offers(base, form.effect, form.shape, sensor))
    return _selected(form.effect, offers[0]) if offers else None


@dataclass(frozen=True, eq=False)
class _Offer:
    """All terms of a shape, and the evidence for the best step of choosing among them."""

    shape: Shape
    choice: Choice
    evidence: float


def _offers(base: Base, effect: LinearEffect, shape: Shape, sensor: int | None = None) -> Iterator[_Offer]:
    """Yield the terms of a shape, at one sensor or all; those of each apart where the effect is of a single one."""
    terms = [
        term
        for term in base.channels.terms(effect, shape)
        if sensor in (None, term.sensor) and (term.sensor != SCALAR or effect.is_of_site or base.channels.has_scalar)
    ]
    if not terms:
        return
    projected, count = base.project(base.channels.design(terms)), base.channels.count - base.rank
    choices = [Choice(projected, terms, base.energy, count)]
    if effect.is_of_one_sensor:
        columns = columns_of(terms)
        groups = [
            [index for index, term in enumerate(terms) if term.sensor == one]
            for one in dict.fromkeys(term.sensor for term in terms)
        ]
        choices = [
            Choice(
                projected.take(np.concatenate([columns[index] for index in group])),
                [terms[index] for index in group],
                base.energy,
                count,
            )
            for group in groups
        ]
    for choice in choices:
        first = choice.first_step()
        if np.isfinite(first):
            yield _Offer(shape, choice, first)


def _selected(effect: LinearEffect, offer: _Offer) -> Hypothesis | None:
    selection = offer.choice.select()
    if not selection.terms:
        return None
    return Hypothesis(effect, offer.shape, tuple(offer.choice.terms[index] for index in selection.terms), selection)
