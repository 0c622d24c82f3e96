"""Which hypotheses a residual supports, beside the causes that are known."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import expm1, log

import numpy as np

from tam_calibration.effects.effect import Effect, Finding
from tam_calibration.effects.grades import LONGEST_BURST, MINOR, NEARLY_ALL, NOTABLE, SLIGHT
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.spikes import A_DOZEN
from tam_calibration.gap.hypothesis import Hypothesis, places_of, sensors_of
from tam_calibration.gap.model import Part
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.repeats import pose_of, repeats
from tam_calibration.gap.rivals import MOST_STEPS, SHARPEST, FunctionOfDirection, surrogate_test_of_change
from tam_calibration.gap.size import Evidence, cached_by_base, cached_by_form, examine, rivals
from tam_calibration.gap.surrogates import SurrogateTest, surrogate_test_of
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect

LEAST_EVIDENCE = 12.0
"""ΔBIC from which a hypothesis counts: odds of 400 to 1 in white noise (Kass and Raftery, JASA 90, 1995: above 10)."""

_LEAST_RATIO = 4.5
"""Least ratio of a form's gain to its best surrogate's, where it leaves more than noise in its sensors.

An effect that only resembles the cause, as another function of the motion, reaches a ratio of four.
"""

_LEAST_RATIO_IN_SEARCH = 2.0
"""The same during the search, when the residual may still hold other causes."""


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search: the hypothesis accepted, its surrogate test, and the evidence for all of them."""

    accepted: Evidence
    weighed: tuple[Evidence, ...]
    surrogate_test: SurrogateTest | None = None


def supported(
    base: Base, weighed: Sequence[Evidence], steps: Sequence[Step], least: float
) -> tuple[Evidence, SurrogateTest | None] | None:
    """Return the supported hypothesis whose evidence exceeds that for its best surrogate most, with its test.

    Parameters
    ----------
    base : Base
        The calibration with all known causes.
    weighed : sequence of Evidence
        Evidence for each effect.
    steps : sequence of Step
        The known causes.
    least : float
        Energy that a cause must explain.
    """
    best: tuple[Evidence, SurrogateTest | None] | None = None
    beyond = 0.0
    held: list[tuple[Evidence, SurrogateTest | None]] = []
    for candidate in sorted(weighed, key=lambda one: (-one.is_certain, -_comparable_evidence(one))):
        if not candidate.is_certain and _comparable_evidence(candidate) <= beyond:
            break
        if candidate.delta_bic < LEAST_EVIDENCE or energy_explained(candidate, base) < least:
            continue
        if not is_new(candidate, steps, base):
            continue
        is_held, surrogate_test = support_of(base, candidate)
        if not is_held:
            continue
        excess = beyond_surrogates(candidate, surrogate_test)
        if candidate.is_certain:
            return candidate, surrogate_test
        held.append((candidate, surrogate_test))
        if excess > beyond:
            best, beyond = (candidate, surrogate_test), excess
    if best is None:
        return None
    others = [one for one, _ in held]
    chosen = special_case(_told(best[0], others), others)
    return next(one for one in held if one[0] is chosen)


def _told(best: Evidence, others: Sequence[Evidence]) -> Evidence:
    """Return what tells more than an effect that is free in time, if anything does, else that effect.

    Their surrogates are of different kinds, so that the surrogate tests cannot be compared: evidence decides. A
    recorded channel, which has no time to choose, only has to explain nearly as much: it is measured to some per cent.
    """
    if not _is_free_in_time(best):
        return best
    bound = {one: one.form for one in others if isinstance(one.form, Hypothesis) and not _is_free_in_time(one)}
    recorded = [one for one in bound if _follows_channel(bound[one]) and _leaves_what_models_leave(one, best)]
    return max(recorded or [best, *bound], key=lambda one: one.delta_bic)


def _is_free_in_time(one: Evidence) -> bool:
    return isinstance(one.form, Hypothesis) and one.form.effect.is_free_in_time


def _follows_channel(form: Hypothesis) -> bool:
    """Whether a form is of an effect of a recorded channel, or has terms of further currents or actuators."""
    effect = form.effect
    own = tuple(Contribution(term.sensor, term.axis, term.name, {}) for term in form.terms)
    further = set(effect.needs(FittedEffect(effect.name, form.shape, own))) - set(effect.channels)
    return effect.surrogates == "of_channel" or bool(further)


def special_case(best: Evidence, others: Sequence[Evidence]) -> Evidence:
    """Return the special case of a hypothesis that has more evidence or explains nearly as much, else itself.

    Parameters
    ----------
    best : Evidence
        The hypothesis.
    others : sequence of Evidence
        Hypotheses in the same residual, some of which may be special cases of it.
    """
    nearly = [
        one
        for one in others
        if isinstance(one.form, Hypothesis)
        and one.form.effect.is_within(best.effect)
        and (one.delta_bic > best.delta_bic or (_is_simpler(one, best) and _explains_nearly_as_much(one, best)))
    ]
    return max(nearly, key=lambda one: one.delta_bic, default=best)


def _is_simpler(one: Evidence, best: Evidence) -> bool:
    """Whether a form takes no more coefficients, or is one law of all sensors where the other has one for each."""
    assert isinstance(one.form, Hypothesis)
    if not isinstance(best.form, Hypothesis):
        return one.form.selection.rank <= best.form.parameter_count
    own, other = (sensors_of(places_of(form)) for form in (one.form, best.form))
    is_of_each = len(other - {SCALAR, ALL}) > 1
    return one.form.selection.rank <= best.form.selection.rank or (ALL in own and is_of_each)


def _explains_nearly_as_much(one: Evidence, best: Evidence) -> bool:
    """Whether a special case has nearly the same evidence; one that is no exact limit may leave what models leave.

    Effects are modelled to some per cent of their amplitude. Far above the noise as little is much evidence.
    """
    if one.gain > NEARLY_ALL * best.gain:
        return True
    is_exact = not isinstance(one.form, Hypothesis) or best.effect not in one.form.effect.nearly_within
    return not is_exact and _leaves_what_models_leave(one, best)


def _leaves_what_models_leave(one: Evidence, best: Evidence) -> bool:
    """Whether a form explains what another does but for a twentieth of the amplitude."""
    forms = [each.form for each in (one, best) if isinstance(each.form, Hypothesis)]
    return len(forms) == 2 and forms[0].selection.gain > (1 - SLIGHT**2) * forms[1].selection.gain


def beyond_surrogates(one: Evidence, surrogate_test: SurrogateTest | None) -> float:
    """Return by how much a hypothesis' evidence exceeds that for its best surrogate.

    Parameters
    ----------
    one : Evidence
        For the hypothesis.
    surrogate_test : SurrogateTest, optional
        None where there is none: its ΔBIC counts, reduced for an effect that explains any excess of variance.
    """
    return one.gain - surrogate_test.largest if surrogate_test else _comparable_evidence(one)


def _comparable_evidence(one: Evidence) -> float:
    """Return the evidence, reduced for an effect that explains any excess of variance."""
    return one.delta_bic * (NOTABLE if _effect_of(one).explains_any_excess else 1.0)


def _effect_of(one: Evidence) -> Effect:
    return one.form.effect if isinstance(one.form, Hypothesis) else effect_named(one.effect)


def _is_step(one: Evidence) -> bool:
    return isinstance(one.form, Hypothesis) and one.form.effect.is_step


@cached_by_base
def support_of(base: Base, candidate: Evidence) -> tuple[bool, SurrogateTest | None]:
    """Return whether a residual supports a hypothesis, and its surrogate test, where it has one.

    Parameters
    ----------
    base : Base
        Null model: the calibration with the causes that are known.
    candidate : Evidence
        For the hypothesis, in the residual of this base.
    """
    form = candidate.form
    if isinstance(form, Finding):
        # Noise or spikes explain as much as any function without physics in their sensors.
        gains = (_gain_in_sensors(base, form, one) for one in rivals(base))
        return candidate.is_certain or all(candidate.gain >= gain for gain in gains), None
    follows_field_alone = not (form.effect.is_free_in_time or form.effect.channels)
    if follows_field_alone and _is_of_direction(base, candidate):
        return False, None
    if candidate.delta_bic < LEAST_EVIDENCE:
        return False, None
    if form.effect.oversize(base.channels.covariates, _fitted_at(base, form)) is not None:
        return False, None
    is_in_time = form.effect.is_free_in_time or form.effect.is_step or form.effect.surrogates == "at_other_frequencies"
    if is_in_time and _is_of_pose(base, form):
        return False, None
    permanent = form.effect.always(form.shape)
    if permanent is not None:
        change_test, is_smooth = surrogate_test_of_change(base, form, permanent, candidate.delta_bic)
        is_sharp = not is_smooth or change_test.ratio > SHARPEST * NOTABLE
        if not is_sharp or form.effect.surrogates == "at_other_times":
            return is_sharp, change_test
    surrogate_test = _surrogate_test(base, form)
    if surrogate_test.gain <= surrogate_test.largest + LEAST_EVIDENCE:
        return False, surrogate_test
    is_promising = form.effect.surrogates == "of_channel" or surrogate_test.ratio > _LEAST_RATIO_IN_SEARCH
    return is_promising or _is_complete(base, form), surrogate_test


def _is_far_out(surrogate_test: SurrogateTest, form: Hypothesis) -> bool:
    """Whether a form exceeds its surrogates so far that it is a cause even if more than noise remains.

    Effects free in time or free to switch explain little in other rows in any case: that is no test of them.
    """
    if form.effect.always(form.shape) is not None:
        return surrogate_test.ratio > SHARPEST
    is_recorded = form.effect.surrogates == "of_channel"
    least = 1 + NOTABLE if is_recorded else _LEAST_RATIO
    return form.effect.surrogates != "elsewhere" and surrogate_test.ratio > least


def _is_complete(base: Base, form: Hypothesis) -> bool:
    """Whether a form leaves little more than noise in its sensors."""
    if form.effect.always(form.shape) is not None:
        return _unexplained_part(base, form) < MINOR
    is_recorded = form.effect.surrogates == "of_channel"
    return _unexplained_part(base, form) < (NOTABLE if is_recorded else SLIGHT)


@cached_by_form
def _unexplained_part(base: Base, form: Hypothesis) -> float:
    """Return the part of the explainable energy in the sensors of a form that it leaves to functions without physics.

    An effect that only resembles the cause leaves a residual there.
    """
    beside = base.beside(base.channels.design(form.terms))
    gain = max((_gain_in_sensors(beside, form, one) for one in rivals(beside)), default=0.0)
    unexplained = beside.energy * -expm1(-gain / base.channels.count)
    return unexplained / (unexplained + base.energy - beside.energy)


def _is_of_pose(base: Base, form: Hypothesis) -> bool:
    """Whether what a form adds is the same at every pose that is taken up again."""
    covariates = base.channels.covariates
    again, part = repeats(pose_of(covariates)), Part.at(base, form)
    return again is not None and again.are_same(part.signal(part.terms(base.channels), covariates.scalar_row + 1))


def _fitted_at(base: Base, form: Hypothesis) -> FittedEffect:
    """Return a form with the coefficients of least squares at a null model."""
    return Part.at(base, form).fitted(form.terms)


@cached_by_base
def holds(base: Base, cause: Evidence) -> bool:
    """Whether a cause still is supported at the base of all other causes.

    Parameters
    ----------
    base : Base
        Null model: the calibration with all other causes.
    cause : Evidence
        As it was accepted; its terms are fitted again at this base.
    """
    form = cause.form
    if isinstance(form, Finding):
        return not _effect_of(cause).explains_any_excess or isinstance(examine(base, _effect_of(cause)), Evidence)
    moved = form.moved(base.channels.covariates)
    gain, rank = base.project(base.channels.design(moved.terms)).gain()
    gain = twice_log_likelihood_ratio(base.energy, gain, base.channels.count)
    alone = Evidence(cause.effect, moved, gain - rank * log(base.channels.count), gain)
    is_held, surrogate_test = support_of(base, alone)
    if not is_held or surrogate_test is None:
        return is_held
    return _is_far_out(surrogate_test, moved) or _is_complete(base, moved)


_surrogate_test = cached_by_form(surrogate_test_of)


def open_part(first: Base, last: Base, unknown: Sequence[Evidence]) -> float:
    """Return the part of the explainable energy that causes leave to functions without physics, 0 to 1.

    Parameters
    ----------
    first, last : Base
        Without the causes, and with them.
    unknown : sequence of Evidence
        For functions without physics, in the residual with the causes.
    """
    left = max((energy_explained(one, last) for one in unknown if one.delta_bic > LEAST_EVIDENCE), default=0.0)
    return left / max(left + first.energy - last.energy, np.finfo(float).tiny)


def energy_explained(one: Evidence, base: Base) -> float:
    """Return the energy that a hypothesis explains of the residual of a base.

    Parameters
    ----------
    one : Evidence
        For the hypothesis, in the residual of this base.
    base : Base
        Null model with its residual energy.
    """
    return base.energy * -expm1(-one.gain / base.channels.count)


def is_new(candidate: Evidence, steps: Sequence[Step], base: Base) -> bool:
    """Whether a candidate is a cause of its own beside those accepted, not a repetition or special case of one.

    Parameters
    ----------
    candidate : Evidence
        For the hypothesis that may be accepted.
    steps : sequence of Step
        Causes that were accepted.
    base : Base
        The calibration with these causes.
    """
    same_effect = [step.accepted for step in steps if step.accepted.effect == candidate.effect]
    sensors = sensors_of(places_of(candidate.form))
    if isinstance(candidate.form, Hypothesis) and candidate.form.effect.is_of_one_sensor:
        same_effect = [one for one in same_effect if sensors & sensors_of(places_of(one.form))]
    if isinstance(candidate.form, Hypothesis) and candidate.form.effect.is_of_each_sensor:
        of_one = [one for one in same_effect if len(sensors_of(places_of(one.form))) == 1]
        same_effect = same_effect if len(same_effect) > 1 else of_one
    if same_effect and not _effect_of(candidate).may_repeat:
        return False
    if any(_is_same(candidate, other, base) for other in same_effect):
        return False
    flagged = candidate.form.flagged if isinstance(candidate.form, Finding) else None
    if flagged is not None and not (flagged & base.channels.is_counted).any():
        return False
    if _effect_of(candidate).is_of_lone_samples and _are_many([candidate, *same_effect]):
        return False
    there = [step.accepted for step in steps if sensors & sensors_of(places_of(step.accepted.form))]
    if any(_is_nested(candidate, other) for other in there):
        return False
    return not _is_step(candidate) or _changes([candidate, *there], base.channels.covariates.step_s) <= MOST_STEPS


def _is_same(one: Evidence, other: Evidence, base: Base) -> bool:
    """Whether two forms of an effect are one cause."""
    if not (isinstance(one.form, Hypothesis) and isinstance(other.form, Hypothesis)):
        return False
    return one.form.effect.is_same(one.form.shape, other.form.shape, base.channels.covariates)


def absorbed(accepted: Evidence, steps: Sequence[Step]) -> Evidence:
    """Return noise or spikes in sensors that saturate, round or lose samples as a part of that cause.

    Parameters
    ----------
    accepted : Evidence
        For the hypothesis that is accepted now.
    steps : sequence of Step
        Causes that were accepted before.
    """
    if not isinstance(accepted.form, Finding) or accepted.is_certain:
        return accepted
    sensors = sensors_of(places_of(accepted.form))
    for step in steps:
        before = step.accepted
        if not isinstance(before.form, Finding) or _effect_of(before).is_of_lone_samples:
            continue
        is_of_samples = before.is_certain or before.form.flagged is not None
        if is_of_samples and sensors <= sensors_of(places_of(before.form)):
            return replace(accepted, effect=before.effect, form=replace(accepted.form, fitted=before.form.fitted))
    return accepted


def _is_of_direction(base: Base, cause: Evidence) -> bool:
    """Whether a function of the direction explains more than a cause in its sensors, whatever axis and time."""
    others = [one for one in rivals(base) if one.effect == FunctionOfDirection.name]
    return any(cause.gain < NEARLY_ALL * _gain_in_sensors(base, cause.form, one) for one in others)


def _gain_in_sensors(base: Base, form: Hypothesis | Finding, other: Evidence) -> float:
    """Return the gain of a function without physics in the sensors of a form; 0 where it has no evidence."""
    sensors = sensors_of(places_of(form))
    terms = other.form.terms if isinstance(other.form, Hypothesis) and other.delta_bic > LEAST_EVIDENCE else ()
    there = [term for term in terms if term.sensor in sensors or ALL in sensors]
    gain = base.project(base.channels.design(there)).gain()[0] if there else 0.0
    return float(twice_log_likelihood_ratio(base.energy, gain, base.channels.count))


def _is_nested(one: Evidence, other: Evidence) -> bool:
    """Whether one of two is a special case of the other."""
    effects = [form.effect for form in (one.form, other.form) if isinstance(form, Hypothesis)]
    return len(effects) == 2 and (effects[0].is_within(effects[1].name) or effects[1].is_within(effects[0].name))


def _are_many(causes: Sequence[Evidence]) -> bool:
    """Whether findings flag more samples than lone ones are."""
    flags = [one.form.flagged for one in causes if isinstance(one.form, Finding) and one.form.flagged is not None]
    flagged = np.any(flags, axis=0)
    return bool(flagged.sum() > max(SLIGHT * len(flagged), A_DOZEN))


def _changes(causes: Sequence[Evidence], step_s: float) -> int:
    """Return the number of times at which biases or scale factors change."""
    forms = [one.form for one in causes if _is_step(one)]
    times = sorted(time for form in forms if isinstance(form, Hypothesis) for time in form.shape.values())
    return sum(
        later - time > LONGEST_BURST * step_s for time, later in zip(times, [*times[1:], float("inf")], strict=True)
    )
