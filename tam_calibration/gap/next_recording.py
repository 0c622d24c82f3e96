"""What to record next: the recording that separates two hypotheses, or shows an effect that this one cannot."""

from collections.abc import Collection, Iterable, Sequence

from numpy.linalg import LinAlgError

from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.gap.candidates import Setting, candidates, visible_part
from tam_calibration.gap.evidence import CHANNEL_NAMES, Evidence
from tam_calibration.gap.hypothesis import places_of
from tam_calibration.gap.result import Cause, Verdict
from tam_calibration.gap.search import Search
from tam_calibration.gap.separation import (
    Ambiguity,
    ambiguity_of,
    channels_of,
    duration,
    long_enough,
    rounded,
    separate,
    with_channels,
    words_of,
)
from tam_calibration.gap.support import LEAST_EVIDENCE
from tam_calibration.model.exceptions import InputError, Refused

_TWICE = (
    "make the same motion twice with a pause between: what comes again belongs to the motion, the rest to the time; "
    "note what is switched, moved or warms up meanwhile"
)

_OTHERWISE = {
    "function_of_time": _TWICE,
    "function_of_neighbours": _TWICE,
    "function_of_rate": "make the same motion at half and at twice the rate: what grows with the rate is a delay or a "
    "current that the turning drives",
    "function_of_direction": "make the same turns at another place and in the opposite sense: what stays goes with the "
    "array, what changes with the site, what turns round is a memory",
    "function_of_tilt": "tilt the array to all sides at several headings: what follows the tilt alone is moved by its "
    "weight, and a loose part is heard or felt",
}
"""What to record for a gap that a function without physics explains, and no untried effect could cause."""


def next_recording(found: Search, verdict: Verdict, causes: Sequence[Cause], variance: float) -> str:
    """Say what to record next.

    Parameters
    ----------
    found : Search
        Result of the search in this recording.
    verdict : str
        Of the diagnosis.
    causes : sequence of Cause
        The largest share first.
    variance : float
        Of the channels' white noise, over that of the array.

    Returns
    -------
    str
        One or two sentences: motion, duration and channels of the recording that brings the most evidence per minute,
        and how much that is by simulation.
    """
    if verdict == "no_gap":
        return (
            "No further recording is needed for this question; one more run of the same kind, kept out of the "
            "calibration, would confirm that it holds."
        )
    try:
        return _of_gap(found, verdict, causes, variance)
    except (InputError, Refused, LinAlgError) as problem:
        return (
            f"Repeat this recording with slower and faster turns: what else would help cannot be simulated ({problem})."
        )


def _of_gap(found: Search, verdict: Verdict, causes: Sequence[Cause], variance: float) -> str:
    setting = Setting(found.model, found.model.channels().covariates, variance)
    ambiguity = ambiguity_of(found, verdict, causes)
    if ambiguity is not None:
        return _told_apart(setting, ambiguity)
    missing = {one.effect for one in found.considered if one.status in ("channel_missing", "not_identifiable")}
    if verdict == "explained":
        hidden = _hidden(found, causes, missing)
        return (hidden and _shown(setting, *hidden)) or _CONFIRMED
    unknown = _strongest(found.rivals if verdict == "unexplained" else found.remaining)
    if unknown is None:
        return "Repeat this recording: what comes again belongs to the array or the site, the rest to this run."
    plausible = [name for name in _plausible(unknown.effect) if name in missing]
    return _shown(setting, unknown, plausible) or f"To see what the rest follows, {_OTHERWISE[unknown.effect]}."


_CONFIRMED = (
    "No further recording is needed for this question; one more run of the same kind, kept out of the fit and "
    "corrected with this cause, would confirm it."
)


def _told_apart(setting: Setting, ambiguity: Ambiguity) -> str:
    separation = separate(setting, ambiguity)
    if separation is not None:
        return separation.sentence
    names = [one.effect for one in (ambiguity.first, ambiguity.second)]
    asked = ", and ".join(dict.fromkeys(effect_named(name).excitation for name in names))
    return f"To tell {words_of(names[0])} from {words_of(names[1])}, record {asked}."


def _strongest(unknown: Iterable[Evidence]) -> Evidence | None:
    strong = [one for one in unknown if one.delta_bic > LEAST_EVIDENCE and one.effect in _OTHERWISE]
    return max(strong, key=lambda one: one.delta_bic, default=None)


def _hidden(found: Search, causes: Sequence[Cause], missing: Collection[str]) -> tuple[Evidence, list[str]] | None:
    """Return a cause that may be another effect which this recording cannot show, and the names of such effects."""
    drift = next((one.gain for one in found.rivals if one.effect == "function_of_time"), 0.0)
    named = {cause.fitted.effect for cause in causes}
    for accepted in (step.accepted for step in found.steps if step.accepted.effect in named):
        effect = effect_named(accepted.effect)
        others = [name for name in (*_exceeding(effect), *effect.may_be) if name in missing]
        is_sharp = isinstance(effect, LinearEffect) and effect.is_step and drift < accepted.gain - LEAST_EVIDENCE
        if others and not is_sharp:
            return accepted, others
    return None


def _exceeding(effect: Effect) -> tuple[str, ...]:
    """Return the names of the effects of which one is a limit."""
    return effect.limit_of if isinstance(effect, LinearEffect) else ()


def _plausible(function: str) -> list[str]:
    """Return the effects that may cause a gap which a function without physics explains, the most plausible first."""
    alike = [effect for effect in installed_effects().values() if function in effect.looks_like]
    return [effect.name for effect in sorted(alike, key=lambda effect: effect.looks_like[function])]


def _shown(setting: Setting, unknown: Evidence, plausible: Sequence[str]) -> str | None:
    """Return the recording in which the most plausible of some effects would be visible, if it causes the gap."""
    sensors = {sensor for sensor, _ in places_of(unknown.form)}
    for name in plausible:
        effect = effect_named(name)
        if not isinstance(effect, LinearEffect):
            continue
        needed = channels_of([effect])
        offers = [
            (visible_part(setting, effect, offer, sensors) * unknown.gain * offer.minutes / setting.minutes, offer)
            for offer in candidates(setting.covariates, needed)
        ]
        expected, best = max(offers, key=lambda offer: offer[0] / offer[1].minutes)
        minutes = long_enough(expected, best.minutes)
        expected *= minutes / best.minutes
        if expected < LEAST_EVIDENCE:
            continue
        return (
            f"To see whether it is {words_of(name)}, {best.words}, {duration(minutes)}{with_channels(needed)}"
            f"{_also(setting, plausible, needed)}. If it makes this gap, the evidence for it (twice the logarithm of "
            f"the likelihood ratio), which this recording cannot give, would be about {rounded(expected)}; above "
            f"{LEAST_EVIDENCE:.0f} decides."
        )
    return None


def _also(setting: Setting, plausible: Iterable[str], needed: Collection[str]) -> str:
    """Return what else should be recorded because another plausible effect needs it."""
    others = [channel for channel in channels_of(map(effect_named, plausible)) if channel not in needed]
    missing = [CHANNEL_NAMES[channel] for channel in others if getattr(setting.model.recording, channel) is None]
    return f" (and the {' and '.join(missing)}, which may be the cause as well)" if missing else ""
