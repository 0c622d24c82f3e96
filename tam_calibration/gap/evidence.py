"""The evidence for each hypothesis at a model: the library's effects, and rival functions without physics."""

from collections.abc import Callable, Collection, Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from math import log
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Effect, Finding, FoundEffect, LinearEffect
from tam_calibration.effects.grades import NEARLY_ALL
from tam_calibration.gap.hypothesis import Hypothesis, best_form, refined
from tam_calibration.gap.regression import Base, twice_log_likelihood_ratio
from tam_calibration.gap.result import Considered
from tam_calibration.gap.rivals import (
    FunctionOfDirection,
    FunctionOfNeighbours,
    FunctionOfRate,
    FunctionOfTilt,
    FunctionOfTime,
)
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.recording import Recording

Value = TypeVar("Value")


def cached_by_base(function: Callable[..., Value]) -> Callable[..., Value]:
    """Cache the values of a function of a base, or of a base and one argument, as long as these objects exist."""
    known: WeakKeyDictionary[Base, WeakKeyDictionary[Any, Value]] = WeakKeyDictionary()

    @wraps(function)
    def cached(base: Base, *arguments: Any) -> Value:
        of_base = known.setdefault(base, WeakKeyDictionary())
        key = arguments[0] if arguments else base
        if key not in of_base:
            of_base[key] = function(base, *arguments)
        return of_base[key]

    return cached


def cached_by_form(function: Callable[[Base, Hypothesis], Value]) -> Callable[[Base, Hypothesis], Value]:
    """Cache what depends on a base and on the terms of a form there, as long as the base exists."""
    known: WeakKeyDictionary[Base, dict[Hashable, Value]] = WeakKeyDictionary()

    @wraps(function)
    def cached(base: Base, form: Hypothesis) -> Value:
        of_base = known.setdefault(base, {})
        if form.identity not in of_base:
            of_base[form.identity] = function(base, form)
        return of_base[form.identity]

    return cached


CHANNEL_NAMES = {
    "scalar_T": "scalar magnetometer",
    "temperature_C": "temperature",
    "current_A": "current",
    "attitude": "attitude",
}
"""The channels of a recording in words."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for one hypothesis in a model's residual.

    Parameters
    ----------
    effect : str
        Name of the effect.
    form : Hypothesis or Finding
        Its form with the most evidence.
    delta_bic : float
        BIC of the model without it less that of the model with it: positive speaks for it.
    gain : float
        Twice the log-likelihood ratio.
    is_certain : bool
        See ``Finding``.
    """

    effect: str
    form: Hypothesis | Finding
    delta_bic: float
    gain: float
    is_certain: bool = False


def unusable(effect: Effect, recording: Recording, covariates: Covariates) -> Considered | None:
    """Return why a recording cannot show an effect, or None where it can.

    Parameters
    ----------
    effect : Effect
        Its channels must be recorded, and it must see no obstacle in the covariates.
    recording : Recording
        As given, with None for a channel that was not recorded.
    covariates : Covariates
        Of the recording at the nominal calibration.
    """
    for channel in effect.channels:
        if getattr(recording, channel, None) is None:
            name = CHANNEL_NAMES[channel]
            return Considered(effect.name, "channel_missing", f"needs the {name} channel, which is not recorded")
    obstacle = effect.obstacle(covariates)
    return None if obstacle is None else Considered(effect.name, "not_identifiable", obstacle)


def usable(
    effects: Mapping[str, Effect], without: Collection[str], channels: WhitenedChannels
) -> tuple[dict[str, Effect], list[Considered]]:
    """Return the effects that this recording can show, and why it cannot show the others.

    Parameters
    ----------
    effects : mapping of str to Effect
        By name.
    without : collection of str
        Names of effects that are passed over.
    channels : WhitenedChannels
        Of the recording at the nominal calibration.
    """
    tried, considered = {}, []
    for name, effect in effects.items():
        if name in without:
            continue
        reason = unusable(effect, channels.recording, channels.covariates)
        if reason is None:
            tried[name] = effect
        else:
            considered.append(reason)
    return tried, considered


@cached_by_base
def examine(base: Base, effect: Effect) -> Evidence | str:
    """Return the evidence for an effect, or why there is none.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which evidence is sought.
    effect : Effect
        Fitted by regression, or found by a test of its own.
    """
    if isinstance(effect, LinearEffect):
        form = best_form(base, effect)
        if form is None:
            return "no part of it is visible beside the calibration in this recording"
        return evidence_of(base, form)
    assert isinstance(effect, FoundEffect)
    finding = effect.find(base.channels.residuals)
    if isinstance(finding, str):
        return finding
    delta_bic = finding.gain - finding.parameter_count * log(base.channels.count)
    return Evidence(effect.name, finding, delta_bic, finding.gain, finding.is_certain)


def evidence_of(base: Base, form: Hypothesis) -> Evidence:
    """Return the evidence for an effect in a form.

    Parameters
    ----------
    base : Base
        Null model at which the form was selected.
    form : Hypothesis
        Terms of the effect, with the energy that they explain and their ΔBIC.
    """
    gain = twice_log_likelihood_ratio(base.energy, form.selection.gain, base.channels.count)
    return Evidence(form.effect.name, form, form.selection.delta_bic, gain)


def sharpened(base: Base, weighed: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """Return the evidence with the shapes of the strongest effects refined, and of special cases of the strongest.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the shapes are refined.
    weighed : sequence of Evidence
        For the effects, at this base; those with nearly the largest ΔBIC are refined.
    """
    strongest = max(weighed, key=lambda one: one.delta_bic, default=None)
    if strongest is None or strongest.delta_bic <= 0:
        return tuple(weighed)
    return tuple(_refined(base, one) if _is_near(one, strongest) else one for one in weighed)


def _is_near(one: Evidence, strongest: Evidence) -> bool:
    """Whether a hypothesis has nearly the evidence of the strongest, or is a special case of it that has any."""
    if not isinstance(one.form, Hypothesis) or one.delta_bic <= 0:
        return False
    return one.delta_bic > NEARLY_ALL * strongest.delta_bic or one.form.effect.is_within(strongest.effect)


@cached_by_base
def _refined(base: Base, one: Evidence) -> Evidence:
    assert isinstance(one.form, Hypothesis)
    return evidence_of(base, refined(base, one.form))


@cached_by_base
def rivals(base: Base) -> tuple[Evidence, ...]:
    """Return the evidence for the functions without physics."""
    kinds = (FunctionOfTime, FunctionOfDirection, FunctionOfTilt, FunctionOfRate, FunctionOfNeighbours)
    recording = base.channels.recording
    usable = [kind() for kind in kinds if all(getattr(recording, name) is not None for name in kind.channels)]
    return tuple(one for one in (examine(base, kind) for kind in usable) if isinstance(one, Evidence))
