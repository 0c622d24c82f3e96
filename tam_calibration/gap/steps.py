"""The steps of the search: which effects count as causes of their own, and not as a repetition or part of another."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.effects.effect import Effect, Finding
from tam_calibration.effects.grades import LONGEST_BURST, NEARLY_ALL, SLIGHT
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.outliers import A_DOZEN
from tam_calibration.gap.hypothesis import Hypothesis, places_of, sensors_of
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.regression import Base
from tam_calibration.gap.size import Evidence
from tam_calibration.model.fitted_effect import ALL, SCALAR

MOST_CAUSES = 4
"""Causes of one gap, at most: a recording seldom separates more."""

MOST_STEPS = 3
"""Steps of one sensor's bias or scale, at most; what changes more often is a loose part or contact."""

LEAST_EVIDENCE = 12.0
"""ΔBIC from which a hypothesis counts: odds of 400 to 1 in white noise (Kass and Raftery, JASA 90, 1995: above 10)."""


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the search.

    Parameters
    ----------
    accepted : Evidence
        For the effect that was accepted.
    law : Signature
        That it explains.
    others : tuple of str
        Effects that leave as little of the law.
    """

    accepted: Evidence
    law: Signature
    others: tuple[str, ...] = ()


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


def _effect_of(one: Evidence) -> Effect:
    return one.form.effect if isinstance(one.form, Hypothesis) else effect_named(one.effect)


def _is_step(one: Evidence) -> bool:
    return isinstance(one.form, Hypothesis) and one.form.effect.is_step


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
    sensors = sensors_of(places_of(candidate.form))
    there = [step.accepted for step in steps if sensors & sensors_of(places_of(step.accepted.form))]
    same_effect = [one for one in there if one.effect == candidate.effect]
    if same_effect and not _effect_of(candidate).may_repeat:
        return False
    if any(_is_same(candidate, other, base) for other in same_effect):
        return False
    flagged = candidate.form.flagged if isinstance(candidate.form, Finding) else None
    if flagged is not None and not (flagged & base.channels.is_counted).any():
        return False
    if _effect_of(candidate).is_of_lone_samples and _are_many([candidate, *same_effect]):
        return False
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
