"""What a search found: the causes of a gap, and which effects count as causes of their own."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import log

import numpy as np

from tam_calibration.effects.effect import Finding, LinearEffect
from tam_calibration.effects.grades import LONGEST_BURST, MINOR, NEARLY_ALL, SLIGHT
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.single_samples import A_DOZEN
from tam_calibration.effects.states import MOST_STEPS
from tam_calibration.gap.hypothesis import Hypothesis, places_of, sensors_of
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Considered
from tam_calibration.gap.size import Evidence
from tam_calibration.model.fitted_effect import ALL, SCALAR

MOST_CAUSES = 4
"""Causes of one gap, at most: a recording seldom separates more."""

LEAST_EVIDENCE = 12.0
"""ΔBIC from which a hypothesis counts: odds of 400 to 1 in white noise (Kass and Raftery, JASA 90, 1995: above 10)."""

LARGEST_REST = 1.0
"""Residual, in noise floors, that causes may leave: a larger one is a gap of its own."""


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
        For the hypothesis.
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
    if not isinstance(one.form, Hypothesis) or not isinstance(best.form, Hypothesis):
        return False
    is_all_but_slight = one.form.selection.gain > (1 - SLIGHT**2) * best.form.selection.gain
    return is_all_but_slight and best.effect in one.form.effect.nearly_within


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
    form, effect = candidate.form, effect_named(candidate.effect)
    sensors = sensors_of(places_of(form))
    there = [step.accepted for step in steps if sensors & sensors_of(places_of(step.accepted.form))]
    same_effect = [one for one in there if one.effect == candidate.effect]
    if same_effect and not effect.may_repeat:
        return False
    if isinstance(form, Finding):
        if form.flagged is None:
            return True
        is_many = effect.is_of_lone_samples and _are_many([candidate, *same_effect])
        return bool((form.flagged & base.channels.is_counted).any()) and not is_many
    covariates = base.channels.covariates
    others = [one.form for one in there if isinstance(one.form, Hypothesis)]
    if any(
        _is_nested(form.effect, other.effect)
        or (form.effect.name == other.effect.name and form.effect.is_same(form.shape, other.shape, covariates))
        for other in others
    ):
        return False
    return not form.effect.is_step or _changes([form, *others], covariates.step_s) <= MOST_STEPS


def _is_nested(one: LinearEffect, other: LinearEffect) -> bool:
    """Whether one of two is a special case of the other."""
    return one.is_within(other.name) or other.is_within(one.name)


def _are_many(causes: Sequence[Evidence]) -> bool:
    """Whether findings flag more samples than lone ones are."""
    flags = [one.form.flagged for one in causes if isinstance(one.form, Finding) and one.form.flagged is not None]
    flagged = np.any(flags, axis=0)
    return bool(flagged.sum() > max(SLIGHT * len(flagged), A_DOZEN))


def _changes(forms: Sequence[Hypothesis], step_s: float) -> int:
    """Return the number of times at which biases or scale factors change."""
    times = sorted(time for form in forms if form.effect.is_step for time in form.shape.values())
    return sum(later - time > LONGEST_BURST * step_s for time, later in pairwise([*times, np.inf]))


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
        if not isinstance(before.form, Finding) or effect_named(before.effect).is_of_lone_samples:
            continue
        is_of_samples = before.is_certain or before.form.flagged is not None
        if is_of_samples and sensors <= sensors_of(places_of(before.form)):
            return replace(accepted, effect=before.effect, form=replace(accepted.form, fitted=before.form.fitted))
    return accepted


@dataclass(frozen=True, eq=False)
class Search:
    """What a search found.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    steps : tuple of Step
        The causes, in the order in which they were accepted.
    laws, remaining : tuple of Law
        Of the gap, and of what the causes leave of it; the strongest first.
    weighed : tuple of Evidence
        For the effects that were examined at the nominal model.
    considered : tuple of Considered
        Hypotheses without evidence.
    """

    nominal: Model
    model: Model
    steps: tuple[Step, ...]
    laws: tuple[Law, ...]
    remaining: tuple[Law, ...]
    weighed: tuple[Evidence, ...]
    considered: tuple[Considered, ...]

    @property
    def open_part(self) -> float:
        """Part of the energy of all laws that the causes leave, 0 to 1."""
        before, after = self.nominal.base().energy, self.model.base().energy
        left = after * sum(law.part for law in self.remaining)
        return left / max(left + before - after, 1.0)

    @property
    def explains_all(self) -> bool:
        """Whether the causes explain the laws: they leave a small part in their sensors, and nothing elsewhere."""
        is_elsewhere = any(law.signature.is_apart_from(step.law for step in self.steps) for law in self.remaining)
        return self.open_part < MINOR and not is_elsewhere

    @property
    def is_clean(self) -> bool:
        """Whether the causes leave nothing but noise."""
        base = self.model.base()
        # As much again as the noise is a gap of its own.
        return self.explains_all and base.energy < (1 + LARGEST_REST**2) * base.channels.count

    @property
    def evidence(self) -> float:
        """Log-evidence of the model: -BIC."""
        base = self.model.base()
        spent = base.rank + sum(finding.parameter_count for finding in self.model.findings)
        return -base.channels.count * log(base.energy / base.channels.count) - spent * log(base.channels.count)
