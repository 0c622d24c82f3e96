"""The best form of one hypothesis: the terms selected by evidence, over the shapes of an effect, then refined."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from heapq import nlargest

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Finding, LinearEffect
from tam_calibration.effects.states import Times
from tam_calibration.effects.term import Key, Term, chosen
from tam_calibration.gap.regression import Base, Choice, Selection, columns_of, evidence, twice_log_likelihood_ratio
from tam_calibration.model.fitted_effect import SCALAR, FittedEffect, Shape
from tam_calibration.model.units import FloatArray

_FULLY_SELECTED = 2
"""Shapes, those with the best first step, for which the selection of terms is carried out."""

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
    values : (P,) array, optional
        Coefficients to start from, where the fit does not find them from zero.
    """

    effect: LinearEffect
    shape: Shape
    terms: tuple[Term, ...]
    selection: Selection
    tried: tuple[Shape, ...] = ()
    values: FloatArray | None = None

    def moved(self, covariates: Covariates) -> "Hypothesis":
        """Return the same terms of the same shape for other covariates, at all of their samples."""
        return replace(self, terms=tuple(chosen(self.effect.terms(covariates, self.shape), self.keys)))

    @property
    def keys(self) -> tuple[Key, ...]:
        """Keys of the terms."""
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
    offers = (offer for shape in shapes for offer in _offers(base, effect, shape, sensors))
    promising = nlargest(_FULLY_SELECTED, offers, key=lambda offer: offer.evidence)
    selected = (_selected(effect, offer) for offer in promising)
    forms = [form for form in selected if form is not None]
    if not forms:
        return None
    best = replace(max(forms, key=lambda form: form.selection.delta_bic), tried=shapes)
    price = _searched(base, best) * float(np.log(base.channels.count))
    return replace(best, selection=replace(best.selection, delta_bic=best.selection.delta_bic - price))


def _searched(base: Base, form: Hypothesis) -> int:
    """Return the number of parameters of a shape that were searched: those that are no convention, and that matter."""
    if form.effect.has_exact_shapes:
        return len(form.shape)
    return sum(_matters(base, form, name) for name in form.shape)


def _matters(base: Base, form: Hypothesis, name: str) -> bool:
    """Whether several values of a parameter were tried, and the chosen terms are not the same for another one."""
    other = next((shape for shape in form.tried if name in shape and shape[name] != form.shape[name]), None)
    if other is None:
        return len({name in shape for shape in form.tried}) > 1
    changed = base.channels.terms(form.effect, {**form.shape, name: other[name]})
    features = {term.key: term.features for term in changed}
    return any(term.key not in features or np.any(features[term.key] != term.features) for term in form.terms)


def given_form(base: Base, effect: LinearEffect, fitted: FittedEffect) -> Hypothesis:
    """Return an effect with known shape and coefficients as a form.

    Parameters
    ----------
    base : Base
        Null model, at which the evidence is computed.
    effect : LinearEffect
        Of the same name as the fitted one.
    fitted : FittedEffect
        Shape and coefficients, SI; coefficients without a value are zero.
    """
    wanted = {(one.sensor, one.axis, one.term): one for one in fitted.contributions}
    terms = [term for term in base.channels.terms(effect, fitted.shape) if term.key in wanted]
    values = [wanted[term.key].values.get(part.name, 0.0) for term in terms for part in term.coefficients]
    gain, rank = base.project(base.channels.design(terms)).gain()
    selection = Selection(tuple(range(len(terms))), gain, rank, evidence(base.energy, gain, base.channels.count, rank))
    return Hypothesis(effect, fitted.shape, tuple(terms), selection, (), np.array(values))


@dataclass(frozen=True, eq=False)
class _Offer:
    """All terms of a shape, and the evidence of the best first step of their selection."""

    shape: Shape
    choice: Choice
    evidence: float


def _offers(base: Base, effect: LinearEffect, shape: Shape, sensors: frozenset[int]) -> Iterator[_Offer]:
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
    projected, count = base.project(base.channels.design(terms)), base.channels.count - base.rank
    columns = columns_of(terms)
    for apart in dict.fromkeys(term.sensor if effect.is_of_one_sensor else None for term in terms):
        own = [index for index, term in enumerate(terms) if apart in (None, term.sensor)]
        part = projected.take(np.concatenate([columns[index] for index in own]))
        choice = Choice(part, [terms[index] for index in own], base.energy, count)
        first = choice.first_step()
        if np.isfinite(first):
            yield _Offer(shape, choice, first)


def _selected(effect: LinearEffect, offer: _Offer) -> Hypothesis | None:
    selection = offer.choice.select()
    if not selection.terms:
        return None
    return Hypothesis(effect, offer.shape, tuple(offer.choice.terms[index] for index in selection.terms), selection)


_REFINEMENTS = 14
"""Evaluations for one parameter (bounded Brent): accurate to some per cent of the distance between neighbours."""

_MOVES = 40
"""Evaluations for several parameters together (Nelder and Mead)."""

_FIRST_TURN_RAD = 0.4
"""First step of an angle, rad: half of the spacing of the directions that are tried."""

_FIRST_STEP = 0.5
"""First step of another parameter, as a part of the distance to the neighbouring value tried."""

_FINEST_STEP = 0.0125
"""Step at which the simplex ends, as a part of the first."""


def refined(base: Base, form: Hypothesis) -> Hypothesis:
    """Return the form with the parameters of its shape moved, together, to where the chosen terms explain most.

    A direction may turn anywhere; other parameters stay between the neighbours of the best among those tried.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the terms explain energy.
    form : Hypothesis
        With the shapes that were tried; one of an effect with exact shapes stays as it is.
    """
    if form.effect.has_exact_shapes:
        return form
    tried = {name: sorted({shape[name] for shape in form.tried if name in shape}) for name in form.shape}
    spans = {
        name: _Span.of(form.shape[name], tried[name], form.effect.shape_units[name] == "rad")
        for name in form.effect.shape_units
        if len(tried.get(name, ())) > 1
    }
    if not spans:
        return form
    return (_moved if len(spans) == 1 else _moved_together)(base, form, spans)


@dataclass(frozen=True)
class _Span:
    """Search range of a parameter of a shape: start, first step, lower and upper bound."""

    start: float
    step: float
    low: float
    high: float

    @classmethod
    def of(cls, value: float, tried: list[float], is_angle: bool) -> "_Span":
        if is_angle:
            return cls(value, _FIRST_TURN_RAD, -np.inf, np.inf)
        here = tried.index(value)
        low, high = tried[max(here - 1, 0)], tried[min(here + 1, len(tried) - 1)]
        return cls(value, _FIRST_STEP * (high - value or low - value), low, high)


def _moved(base: Base, form: Hypothesis, spans: Mapping[str, _Span]) -> Hypothesis:
    """Return the form with the one parameter of its shape that is free moved between its neighbours."""
    from scipy.optimize import minimize_scalar

    ((name, span),) = spans.items()
    best = _Best(base, form)
    minimize_scalar(
        lambda value: -best.gain_at({name: float(value)}),
        bounds=(span.low, span.high),
        method="bounded",
        options={"maxiter": _REFINEMENTS},
    )
    return best.form


def _moved_together(base: Base, form: Hypothesis, spans: Mapping[str, _Span]) -> Hypothesis:
    """Return the form with several parameters of its shape moved, each in units of its first step."""
    from scipy.optimize import minimize

    best = _Best(base, form)

    def shape(steps: FloatArray) -> Shape:
        return {
            name: span.start + span.step * step
            for (name, span), step in zip(spans.items(), steps.tolist(), strict=True)
        }

    ends = [
        sorted(((span.low - span.start) / span.step, (span.high - span.start) / span.step)) for span in spans.values()
    ]
    minimize(
        lambda steps: -best.gain_at(shape(steps)),
        np.zeros(len(spans)),
        method="Nelder-Mead",
        bounds=ends,
        options={
            "initial_simplex": np.vstack([np.zeros(len(spans)), np.eye(len(spans))]),
            "maxfev": _MOVES,
            "xatol": _FINEST_STEP,
            "fatol": np.inf,
        },
    )
    return best.form


class _Best:
    """The form with the largest gain among the shapes that were tried."""

    def __init__(self, base: Base, form: Hypothesis) -> None:
        self._base, self._start = base, form
        self._gain, self._shape, self._terms = form.selection.gain, form.shape, form.terms

    def gain_at(self, change: Shape) -> float:
        """Return the energy that the terms explain with some parameters changed."""
        shape = {**self._start.shape, **change}
        terms = tuple(chosen(self._base.channels.terms(self._start.effect, shape), self._start.keys))
        gain, _ = self._base.project(self._base.channels.design(terms)).gain()
        if gain > self._gain:
            self._gain, self._shape, self._terms = gain, shape, terms
        return gain

    @property
    def form(self) -> Hypothesis:
        """The best form, with its evidence."""
        selection, energy, count = self._start.selection, self._base.energy, self._base.channels.count
        more = twice_log_likelihood_ratio(energy, self._gain, count)
        more -= twice_log_likelihood_ratio(energy, selection.gain, count)
        selection = replace(selection, gain=self._gain, delta_bic=selection.delta_bic + more)
        return replace(self._start, shape=self._shape, terms=self._terms, selection=selection)
