"""Which hypotheses a residual supports, beside the causes that are known."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from math import expm1, log
from weakref import WeakKeyDictionary

import numpy as np

from tam_calibration.effects.effect import ALL, Contribution, Finding, FittedEffect, SurrogateKind
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.hypotheses import Evidence, examine
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.search import Hypothesis, places_of, sensors_of
from tam_calibration.gap.selection import columns_of
from tam_calibration.gap.standing import Standing
from tam_calibration.gap.surrogates import standing_of
from tam_calibration.gap.unknown import FunctionOfDirection, FunctionOfTime

LEAST_EVIDENCE = 12.0
"""ΔBIC from which a hypothesis counts: odds of 400 to 1 in white noise (Kass and Raftery, JASA 90, 1995: above 10)."""

_LEAST_RATIO: Mapping[SurrogateKind, float] = {
    "moved": 2.0,
    "of_channel": 1.0,
    "of_attitude": 2.0,
    "of_course": 1.1,
    "elsewhere": 1.0,
    "at_other_frequencies": 2.0,
}
"""How many times the best surrogate's gain a form must gain.

What follows the motion in another way gains up to 1.9 times what the moved residual does; a drift without jumps gains
up to 1.3 times what others of its spectrum do.
"""

LEAST_SHARE = 0.08
"""Part of all that can be explained that a cause must explain."""

_NEARLY_ALL = 0.97
"""Part of what a hypothesis gains from which on its special case is the cause."""

_OF_DIRECTION = 0.9
"""Part of what functions of the direction gain in its sensors that an effect of the field alone must gain."""

_OF_TIME = 0.7
"""Part of what smooth functions of time gain in its sensors that a change at some times must gain."""

_MOST_JUMPS = 3
"""Times at which one sensor's bias jumps; what comes and goes more often is a loose part or contact, and no jump."""

_MOST_STRUCK = 0.04
"""Part of the samples that are outliers at most."""

_SAME_TIME = 3.0
"""Sampling steps within which two jumps are one."""

NOISE, OUTLIERS, JUMP = "noise_excess", "outliers", "bias_jump"
_REPEATED = {JUMP, "scale_step", "periodic_interference", NOISE, OUTLIERS}
"""Effects that may happen more than once, each time in another form."""

_OF_EACH_SENSOR = {"temperature_drift"}
"""Effects that each sensor may have in a form of its own, so that two forms tell what several sensors do."""


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: what was accepted, how it stood among its surrogates, and all that was weighed."""

    accepted: Evidence
    weighed: tuple[Evidence, ...]
    rivals: tuple[Evidence, ...]
    standing: Standing | None = None


def supported(
    base: Base, weighed: Sequence[Evidence], unknown: Sequence[Evidence], steps: Sequence[Step], least: float
) -> tuple[Evidence, Standing | None] | None:
    """Return the hypothesis whose evidence exceeds that of its best surrogate most, of those that a residual supports.

    Parameters
    ----------
    base : Base
        The calibration with all causes that are known.
    weighed, unknown : sequence of Evidence
        What speaks for each effect, and for each function without physics.
    steps : sequence of Step
        The causes that are known.
    least : float
        Energy that a cause must explain.
    """
    best: tuple[Evidence, Standing | None] | None = None
    beyond = 0.0
    held: list[tuple[Evidence, Standing | None]] = []
    for candidate in sorted(weighed, key=lambda one: (-one.is_certain, -_worth(one))):
        if _worth(candidate) <= beyond:
            break
        if candidate.delta_bic < LEAST_EVIDENCE or energy_explained(candidate, base) < least:
            continue
        if not is_new(candidate, steps, base):
            continue
        is_held, standing = stands(base, candidate, unknown)
        if not is_held:
            continue
        own = _worth(candidate) - (standing.largest if standing else 0.0)
        if candidate.is_certain:
            return candidate, standing
        held.append((candidate, standing))
        if own > beyond:
            best, beyond = (candidate, standing), own
    return best and _special(best, held)


def _special(
    best: tuple[Evidence, Standing | None], held: Sequence[tuple[Evidence, Standing | None]]
) -> tuple[Evidence, Standing | None]:
    """Return the special case of a hypothesis that explains nearly all that it does, where the residual supports it."""
    nearly = [one for one in held if _is_within(one[0], best[0]) and one[0].gain > _NEARLY_ALL * best[0].gain]
    return max(nearly, key=lambda one: one[0].delta_bic, default=best)


def _is_within(one: Evidence, other: Evidence) -> bool:
    return isinstance(one.form, Hypothesis) and other.effect in one.form.effect.within


def _worth(one: Evidence) -> float:
    """Return the evidence, which that for noise is not worth as much as: noise explains any excess."""
    return one.delta_bic * (_NOISE_WORTH if one.effect == NOISE else 1.0)


_NOISE_WORTH = 0.3
"""Part of the evidence for noise that counts against what says how the excess comes."""


def stands(base: Base, candidate: Evidence, unknown: Sequence[Evidence]) -> tuple[bool, Standing | None]:
    """Return whether a residual supports a hypothesis, and how it stands among its surrogates, where it has any."""
    form = candidate.form
    if isinstance(form, Finding):
        return candidate.is_certain or _is_best(base, candidate, unknown), None
    follows_field_alone = not (form.effect.is_free_in_time or form.effect.channels)
    if follows_field_alone and _is_of_direction(base, candidate, unknown):
        return False, None
    if candidate.delta_bic < LEAST_EVIDENCE:
        return False, None
    if form.effect.oversize(base.channels.situation, fitted_at(base, form)) is not None:
        return False, None
    standing = _standing(base, form)
    is_first = standing.gain > standing.largest + LEAST_EVIDENCE
    return is_first and standing.ratio > _LEAST_RATIO[form.effect.surrogates], standing


def fitted_at(base: Base, form: Hypothesis) -> FittedEffect:
    """Return a form with the values that it takes beside a base."""
    projected = base.project(base.channels.design(form.terms))
    values = projected.inverse()[0] @ projected.score
    contributions = []
    for term, columns in zip(form.terms, columns_of(form.terms), strict=True):
        names = [coefficient.name for coefficient in term.coefficients]
        own = dict(zip(names, values[columns].tolist(), strict=True))
        contributions.append(Contribution(term.sensor, term.axis, term.name, own))
    return FittedEffect(form.effect.name, form.shape, tuple(contributions))


def holds(base: Base, cause: Evidence, unknown: Sequence[Evidence]) -> bool:
    """Whether a cause still is supported at the base of all other causes."""
    form = cause.form
    if isinstance(form, Finding):
        return cause.effect != NOISE or isinstance(examine(base, effect_named(NOISE)), Evidence)
    moved = form.moved(base.channels.situation)
    gain, rank = base.project(base.channels.design(moved.terms)).gain()
    gain = twice_log_likelihood_ratio(base.energy, gain, base.channels.count)
    alone = Evidence(cause.effect, moved, gain - rank * log(base.channels.count), gain)
    if form.effect.surrogates == "of_course" and _is_of_time(base, alone, unknown):
        return False
    return alone.delta_bic > LEAST_EVIDENCE and stands(base, alone, unknown)[0]


_KNOWN: WeakKeyDictionary[Hypothesis, tuple[Base, Standing]] = WeakKeyDictionary()


def _standing(base: Base, form: Hypothesis) -> Standing:
    known = _KNOWN.get(form)
    if known is None or known[0] is not base:
        known = _KNOWN[form] = base, standing_of(base, form)
    return known[1]


def open_part(first: Base, last: Base, unknown: Sequence[Evidence]) -> float:
    """Return the part of all that can be explained that causes leave to functions without physics."""
    left = max((energy_explained(one, last) for one in unknown if one.delta_bic > LEAST_EVIDENCE), default=0.0)
    return left / max(left + first.energy - last.energy, np.finfo(float).tiny)


def energy_explained(one: Evidence, base: Base) -> float:
    """Return the energy that a hypothesis explains of what a base leaves."""
    return base.energy * -expm1(-one.gain / base.channels.count)


def is_new(candidate: Evidence, steps: Sequence[Step], base: Base) -> bool:
    """Whether a candidate may come beside the causes accepted."""
    alike = [step.accepted for step in steps if step.accepted.effect == candidate.effect]
    if candidate.effect in _OF_EACH_SENSOR:
        alike = alike if len(alike) > 1 else [one for one in alike if len(sensors_of(places_of(one.form))) == 1]
    if alike and candidate.effect not in _REPEATED:
        return False
    if isinstance(candidate.form, Finding) and not _gives_up_more(candidate.form, base):
        return False
    if candidate.effect == OUTLIERS and _struck([candidate, *alike]) > _MOST_STRUCK:
        return False
    sensors = sensors_of(places_of(candidate.form))
    there = [step.accepted for step in steps if sensors & sensors_of(places_of(step.accepted.form))]
    if any(_is_nested(candidate, other) for other in there):
        return False
    return candidate.effect != JUMP or _jumps([candidate, *there], base.channels.situation.step_s) <= _MOST_JUMPS


def absorbed(accepted: Evidence, steps: Sequence[Step]) -> Evidence:
    """Return noise or spikes in sensors that saturate or are rounded as part of that: what is left there is of it."""
    if not isinstance(accepted.form, Finding) or accepted.is_certain:
        return accepted
    sensors = sensors_of(places_of(accepted.form))
    for step in steps:
        before = step.accepted
        if not (before.is_certain and isinstance(before.form, Finding)):
            continue
        if sensors <= sensors_of(places_of(before.form)):
            return replace(accepted, effect=before.effect, form=replace(accepted.form, fitted=before.form.fitted))
    return accepted


def _is_best(base: Base, candidate: Evidence, unknown: Collection[Evidence]) -> bool:
    """Whether noise or spikes explain about as much as any function without physics: what has a course is neither."""
    most = max((one.gain for one in unknown if one.delta_bic > LEAST_EVIDENCE), default=0.0)
    return candidate.gain >= most


def _is_of_direction(base: Base, cause: Evidence, unknown: Collection[Evidence]) -> bool:
    """Whether a function of the direction explains more in the sensors of a cause: then no axis and no time matter."""
    return cause.gain < _OF_DIRECTION * _gain_beside(base, cause, unknown, {FunctionOfDirection.name})


def _is_of_time(base: Base, cause: Evidence, unknown: Collection[Evidence]) -> bool:
    """Whether far more has a smooth course in the sensors of a change at some times: then it stands in for that."""
    return cause.gain < _OF_TIME * _gain_beside(base, cause, unknown, {FunctionOfTime.name})


def _gain_beside(base: Base, cause: Evidence, unknown: Collection[Evidence], kinds: Collection[str]) -> float:
    """Return the most that functions without physics of some kinds gain in the sensors of a cause."""
    sensors, most = sensors_of(places_of(cause.form)), 0.0
    for one in unknown:
        if one.effect not in kinds or not isinstance(one.form, Hypothesis):
            continue
        terms = [term for term in one.form.terms if term.sensor in sensors or ALL in sensors]
        if terms:
            gain = base.project(base.channels.design(terms)).gain()[0]
            most = max(most, float(twice_log_likelihood_ratio(base.energy, gain, base.channels.count)))
    return most


def _is_nested(one: Evidence, other: Evidence) -> bool:
    """Whether one of two is a special case of the other."""
    effects = [form.effect for form in (one.form, other.form) if isinstance(form, Hypothesis)]
    return len(effects) == 2 and bool({one.effect, other.effect} & {name for own in effects for name in own.within})


def _struck(causes: Sequence[Evidence]) -> float:
    """Return the part of the samples that findings flag."""
    flags = [one.form.flagged for one in causes if isinstance(one.form, Finding) and one.form.flagged is not None]
    return float(np.any(flags, axis=0).mean())


def _jumps(causes: Sequence[Evidence], step_s: float) -> int:
    """Return the number of times at which biases jump."""
    forms = [one.form for one in causes if one.effect == JUMP]
    times = sorted(time for form in forms if isinstance(form, Hypothesis) for time in form.shape.values())
    return sum(
        later - time > _SAME_TIME * step_s for time, later in zip(times, [*times[1:], float("inf")], strict=True)
    )


def _gives_up_more(finding: Finding, base: Base) -> bool:
    """Whether a finding gives up samples that are still counted, or gives up none at all."""
    return finding.flagged is None or bool((finding.flagged & base.channels.is_counted).any())
