"""What to record next: what separates two hypotheses, or shows an effect that this recording cannot."""

from collections.abc import Collection, Iterable, Sequence

from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.gap.hypothesis import places_of
from tam_calibration.gap.result import Cause, Verdict
from tam_calibration.gap.search import Search
from tam_calibration.gap.size import CHANNEL_NAMES, Evidence
from tam_calibration.gap.support import LEAST_EVIDENCE
from tam_calibration.model.fitted_effect import ALL
from tam_calibration.model.recording import Recording

_OTHERWISE = (
    "To see what the rest follows, make the same motion twice with a pause between, at half the rate, in the opposite "
    "sense, and at another place: what comes again goes with the array, what grows with the rate is a delay or a "
    "current that the turning drives, what turns round is a memory, what changes with the place belongs to the site."
)

_ENOUGH = (
    "No further recording is needed for this question; one more run of the same kind, kept out of the fit, would "
    "confirm the answer."
)


def next_recording(found: Search, verdict: Verdict, causes: Sequence[Cause]) -> str:
    """Say what to record next, and which channels with it.

    Parameters
    ----------
    found : Search
        Result of the search in this recording.
    verdict : str
        Of the diagnosis.
    causes : sequence of Cause
        The largest share first.
    """
    if verdict == "no_gap":
        return _ENOUGH
    recording = found.model.recording
    if pair := close_pair(found, verdict, causes):
        first, second = (_words_of(name) for name in pair)
        return f"To tell {first} from {second}, {_asked(recording, pair)}."
    if matched := [one.fitted.effect for one in causes if one.surrogate_test and one.surrogate_test.is_matched]:
        return (
            f"Let the channel of {_words_of(matched[0])} rise and fall several times in the run: in this one "
            "any other slow drift explains as much."
        )
    missing = {one.effect for one in found.considered if one.status in ("channel_missing", "not_identifiable")}
    if verdict == "explained":
        return _shown(recording, _hidden(found, causes, missing)) or _ENOUGH
    rest = found.rivals if verdict == "unexplained" else found.remaining
    strong = [one for one in rest if one.delta_bic > LEAST_EVIDENCE and one.effect.startswith("function_of")]
    unknown = max(strong, key=lambda one: one.delta_bic, default=None)
    plausible = [name for name in _plausible(unknown.effect) if name in missing] if unknown else []
    return _shown(recording, plausible) or _OTHERWISE


def close_pair(found: Search, verdict: Verdict, causes: Sequence[Cause]) -> tuple[str, str] | None:
    """Return a cause and an effect that comes near it, or the two best effects where there is no cause; None without.

    Parameters
    ----------
    found, verdict, causes
        As for ``next_recording``.
    """
    if verdict == "unexplained":
        ranked = sorted(found.weighed, key=lambda one: -one.delta_bic)[:2]
        if len(ranked) < 2 or ranked[1].delta_bic < max(LEAST_EVIDENCE, ranked[0].delta_bic - LEAST_EVIDENCE):
            return None
        return ranked[0].effect, ranked[1].effect
    named = {cause.fitted.effect for cause in causes}
    for cause in causes:
        step = next(step for step in found.steps if step.accepted.effect == cause.fitted.effect)
        close = [one for one in step.weighed if one.effect not in named and _is_close(step.accepted, one)]
        if close:
            return step.accepted.effect, max(close, key=lambda one: one.delta_bic).effect
    return None


def _is_close(accepted: Evidence, other: Evidence) -> bool:
    """Whether another effect explains nearly as much at the same sensors."""
    if accepted.is_certain:
        return False
    here, there = ({sensor for sensor, _ in places_of(one.form)} for one in (accepted, other))
    if not here & there and ALL not in here | there:
        return False
    return other.delta_bic > max(LEAST_EVIDENCE, accepted.delta_bic - LEAST_EVIDENCE)


def _words_of(effect: str) -> str:
    return effect.replace("_", " ")


def _asked(recording: Recording, names: Iterable[str]) -> str:
    """Return the motion that shows effects, with the channels that they need and that were not recorded."""
    effects = list(map(effect_named, names))
    motions = ", and ".join(dict.fromkeys(effect.excitation for effect in effects))
    needed = dict.fromkeys(channel for effect in effects for channel in effect.channels)
    missing = [CHANNEL_NAMES[channel] for channel in needed if getattr(recording, channel) is None]
    return f"{motions}, with the {' and '.join(missing)} recorded" if missing else motions


def _hidden(found: Search, causes: Sequence[Cause], missing: Collection[str]) -> list[str]:
    """Return the effects, which this recording cannot show, that a cause may be instead."""
    drift = next((one.gain for one in found.rivals if one.effect == "function_of_time"), 0.0)
    named = {cause.fitted.effect for cause in causes}
    for accepted in (step.accepted for step in found.steps if step.accepted.effect in named):
        effect = effect_named(accepted.effect)
        others = [name for name in (*getattr(effect, "limit_of", ()), *effect.may_be) if name in missing]
        is_sharp = isinstance(effect, LinearEffect) and effect.is_step and drift < accepted.gain - LEAST_EVIDENCE
        if others and not is_sharp:
            return others
    return []


def _plausible(function: str) -> list[str]:
    """Return the effects that may cause a gap which a function without physics explains, the most plausible first."""
    effects = [effect for effect in installed_effects().values() if function in effect.looks_like]
    return [effect.name for effect in sorted(effects, key=lambda effect: effect.looks_like[function])]


def _shown(recording: Recording, plausible: Sequence[str]) -> str:
    """Return what would show the most plausible of effects; empty without any."""
    if not plausible:
        return ""
    return f"To see whether it is {_words_of(plausible[0])}, {_asked(recording, plausible[:1])}."
