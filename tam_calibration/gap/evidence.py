"""What speaks for each hypothesis at a model: the library's effects, and the rivals without physics."""

from collections.abc import Callable, Collection, Mapping, Sequence
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

Told = TypeVar("Told")


def kept(tell: Callable[..., Told]) -> Callable[..., Told]:
    """Keep what a function tells of a base, or of a base and something that is asked, as long as these are there."""
    known: WeakKeyDictionary[Base, WeakKeyDictionary[Any, Told]] = WeakKeyDictionary()

    @wraps(tell)
    def told(base: Base, *asked: Any) -> Told:
        of_base = known.setdefault(base, WeakKeyDictionary())
        key = asked[0] if asked else base
        if key not in of_base:
            of_base[key] = tell(base, *asked)
        return of_base[key]

    return told


CHANNEL_NAMES = {
    "scalar_T": "scalar magnetometer",
    "temperature_C": "temperature",
    "current_A": "current",
    "attitude": "attitude",
}
"""What people call the channels of a recording."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What one hypothesis says of a model's residual.

    Parameters
    ----------
    effect : str
        Its name.
    form : Hypothesis or Finding
        In which form it says most.
    delta_bic : float
        The model with it against the model without, positive is for.
    gain : float
        Twice the logarithm of the likelihood ratio.
    is_certain : bool
        See ``Finding``.
    """

    effect: str
    form: Hypothesis | Finding
    delta_bic: float
    gain: float
    is_certain: bool = False


def unusable(effect: Effect, recording: Recording, covariates: Covariates) -> Considered | None:
    """Return why a recording cannot show an effect, or None where it can."""
    for channel in effect.channels:
        if getattr(recording, channel, None) is None:
            name = CHANNEL_NAMES[channel]
            return Considered(effect.name, "channel_missing", f"needs the {name} channel, which is not recorded")
    obstacle = effect.obstacle(covariates)
    return None if obstacle is None else Considered(effect.name, "not_identifiable", obstacle)


def usable(
    effects: Mapping[str, Effect], without: Collection[str], channels: WhitenedChannels
) -> tuple[dict[str, Effect], list[Considered]]:
    """Return the effects that can be tried, and what keeps the others from it."""
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


@kept
def examine(base: Base, effect: Effect) -> Evidence | str:
    """Return the evidence for an effect, or why there is none."""
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
    """Return the evidence for an effect in a form."""
    gain = twice_log_likelihood_ratio(base.energy, form.selection.gain, base.channels.count)
    return Evidence(form.effect.name, form, form.selection.delta_bic, gain)


def sharpened(base: Base, weighed: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """Return the evidence with the shapes of the strongest effects refined."""
    least = NEARLY_ALL * max((one.delta_bic for one in weighed), default=0.0)
    return tuple(
        _refined(base, one) if isinstance(one.form, Hypothesis) and one.delta_bic > max(least, 0.0) else one
        for one in weighed
    )


@kept
def _refined(base: Base, one: Evidence) -> Evidence:
    assert isinstance(one.form, Hypothesis)
    return evidence_of(base, refined(base, one.form))


@kept
def rivals(base: Base) -> tuple[Evidence, ...]:
    """Return what functions without physics say."""
    kinds = (FunctionOfTime, FunctionOfDirection, FunctionOfTilt, FunctionOfRate, FunctionOfNeighbours)
    recording = base.channels.recording
    usable = [kind() for kind in kinds if all(getattr(recording, name) is not None for name in kind.channels)]
    return tuple(one for one in (examine(base, kind) for kind in usable) if isinstance(one, Evidence))
