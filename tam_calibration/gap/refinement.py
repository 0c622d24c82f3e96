"""The parameters of a shape moved to where the terms that were chosen explain most."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.effects.effect import Shape
from tam_calibration.effects.term import chosen
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.search import Hypothesis
from tam_calibration.units import FloatArray

_REFINEMENTS = 14
"""Values of one parameter that are tried, by parabolas: to some per cent of the way between its neighbours."""

_MOVES = 40
"""Sets of several parameters that are tried."""

_FIRST_TURN_RAD = 0.4
"""Radians of a first turn: half of what lies between the directions that are tried."""

_FIRST_STEP = 0.5
"""Of the way to a neighbour."""

_FINEST_STEP = 0.0125
"""Of the first one."""


def refined(base: Base, form: Hypothesis) -> Hypothesis:
    """Return the form with the parameters of its shape moved, together, to where the chosen terms explain most.

    A direction may turn anywhere; other parameters stay between the neighbours of the best among those tried.
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
    """Where a parameter of a shape is looked for: from where, in which first step, between which ends."""

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
