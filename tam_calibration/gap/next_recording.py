"""What to record next: what separates two hypotheses, or shows an effect that this recording cannot."""

from collections.abc import Iterable, Sequence

from tam_calibration.effects.grades import NEARLY_ALL
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.hypothesis import places_of
from tam_calibration.gap.laws.causes import causes_of
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
    if drifting := [one.fitted.effect for one in causes if one.is_drift]:
        return (
            f"Let the channel of {_words_of(drifting[0])} rise and fall several times in the run: in this one "
            "any other slow drift explains as much."
        )
    hidden = [one.effect for one in found.considered if one.status in ("channel_missing", "not_identifiable")]
    if verdict == "explained":
        laws = [step.law for step in found.steps if step.law.course in ("slow", "random")]
    else:
        laws = [law.signature for law in (found.laws if verdict == "unexplained" else found.remaining)]
    possible = [one for law in laws[:1] for one in causes_of(law)]
    for one in possible:
        if one.name in hidden:
            return f"To see whether it is {_words_of(one.name)}, {_asked(recording, [one.name])}."
    if verdict == "explained":
        return _ENOUGH
    return f"To see whether it is {possible[0].title}, {possible[0].proof}." if possible else _OTHERWISE


def is_drift(effect: str, recording: Recording) -> bool:
    """Say whether the channel of an effect rises or falls throughout, so that any other slow course explains as much.

    Parameters
    ----------
    effect : str
        Name of an effect.
    recording : Recording
        Of N samples, with the channels of the effect.
    """
    from scipy.stats import spearmanr

    courses = [
        getattr(recording, name) for name in ("temperature_C", "current_A") if name in effect_named(effect).channels
    ]
    return any(abs(spearmanr(recording.time_s, course).statistic) > NEARLY_ALL for course in courses)


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
