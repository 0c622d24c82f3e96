"""The best form of one hypothesis: over the shapes of an effect, the terms that the data ask for."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tam_calibration.effects.effect import Finding, LinearEffect, Shape, Situation, Term
from tam_calibration.gap.channels import Design
from tam_calibration.gap.regression import Base
from tam_calibration.gap.selection import Selection, select

_REFINEMENTS = 14

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
    """

    effect: LinearEffect
    shape: Shape
    terms: tuple[Term, ...]
    selection: Selection
    tried: tuple[Shape, ...] = ()

    def moved(self, situation: Situation) -> "Hypothesis":
        """Return the same terms of the same shape in another situation."""
        found = {(term.sensor, term.axis, term.name): term for term in self.effect.terms(situation, self.shape)}
        terms = tuple(found[term.sensor, term.axis, term.name] for term in self.terms)
        return replace(self, terms=terms)

    @property
    def design(self) -> Design:
        """The selected terms side by side."""
        return Design.of(self.terms)


def places_of(form: Hypothesis | Finding) -> list[Place]:
    """Return the places of a hypothesis or finding."""
    if isinstance(form, Hypothesis):
        return list(dict.fromkeys((term.sensor, term.axis) for term in form.terms))
    return list(dict.fromkeys((one.sensor, one.axis) for one in form.fitted.contributions))


def best_form(base: Base, effect: LinearEffect) -> Hypothesis | None:
    """Return the form of an effect with the most evidence among its shapes, or None when no part of it is visible."""
    channels = base.channels
    best: Hypothesis | None = None
    shapes = tuple(effect.shapes(channels.situation, channels.misfit))
    for shape in shapes:
        tried = _selected(base, effect, shape)
        if tried is not None and (best is None or tried.selection.delta_bic > best.selection.delta_bic):
            best = replace(tried, tried=shapes)
    return best


def refined(base: Base, form: Hypothesis) -> Hypothesis:
    """Return the form with each parameter of its shape moved to where the chosen terms explain most."""
    for name in form.effect.shape_units:
        values = sorted({shape[name] for shape in form.tried if name in shape})
        form = _refined(base, form, name, values)
    return form


def restricted(base: Base, form: Hypothesis, sensor: int) -> Hypothesis | None:
    """Return what the data ask for of the same effect and shape at one sensor."""
    return _selected(base, form.effect, form.shape, sensor)


def _selected(base: Base, effect: LinearEffect, shape: Shape, sensor: int | None = None) -> Hypothesis | None:
    terms = [term for term in effect.terms(base.channels.situation, shape) if sensor in (None, term.sensor)]
    if not terms:
        return None
    projected = base.project(Design.of(terms))
    selection = select(projected, terms, base.energy, base.channels.count - base.rank)
    if not selection.terms:
        return None
    return Hypothesis(effect, shape, tuple(terms[index] for index in selection.terms), selection)


def _refined(base: Base, form: Hypothesis, name: str, tried: list[float]) -> Hypothesis:
    """Return the form with one parameter of its shape moved to where the chosen terms explain most."""
    if name not in form.shape or len(tried) < 2:
        return form
    from scipy.optimize import minimize_scalar

    here = tried.index(form.shape[name])
    bounds = tried[max(here - 1, 0)], tried[min(here + 1, len(tried) - 1)]
    keys = {(term.sensor, term.axis, term.name) for term in form.terms}

    def at(value: float) -> tuple[Shape, tuple[Term, ...], float]:
        shape = {**form.shape, name: float(value)}
        terms = form.effect.terms(base.channels.situation, shape)
        kept = tuple(term for term in terms if (term.sensor, term.axis, term.name) in keys)
        return shape, kept, base.project(Design.of(kept)).gain()[0]

    found: Any = minimize_scalar(
        lambda value: -at(value)[2], bounds=bounds, method="bounded", options={"maxiter": _REFINEMENTS}
    )
    shape, terms, gain = at(found.x)
    if gain <= form.selection.gain:
        return form
    more = base.channels.count * np.log((base.energy - form.selection.gain) / max(base.energy - gain, 1e-300))
    selection = Selection(form.selection.terms, gain, form.selection.rank, form.selection.delta_bic + float(more))
    return replace(form, shape=shape, terms=terms, selection=selection)


def values_of(base: Base, form: Hypothesis) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients (P,) of a form and their covariance for channels of unit variance."""
    projected = base.project(form.design)
    inverse, _ = projected.inverse()
    return inverse @ projected.score, inverse
