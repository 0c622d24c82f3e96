"""What to record next: what separates two hypotheses, or shows an effect that this recording cannot."""

from collections.abc import Iterable, Sequence

from tam_calibration.effects.library import effect_named
from tam_calibration.gap.laws.law import causes_of
from tam_calibration.gap.result import Cause, Verdict
from tam_calibration.gap.size import words_of
from tam_calibration.gap.steps import Search
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
    for cause in causes:
        if cause.indistinguishable_from:
            pair = cause.fitted.effect, cause.indistinguishable_from[0]
            return f"To tell {' from '.join(map(_words_of, pair))}, {_asked(recording, pair)}."
    if drifting := [one.fitted.effect for one in causes if one.is_drift]:
        return (
            f"Let the channel of {_words_of(drifting[0])} rise and fall several times in the run: in this one "
            "any other slow drift explains as much."
        )
    if verdict == "explained":
        return _ENOUGH
    laws = found.laws if verdict == "unexplained" else found.remaining
    possible = causes_of(laws[0].signature) if laws else ()
    hidden = {one.effect for one in found.considered if one.status in ("channel_missing", "not_identifiable")}
    for one in possible:
        if one.name in hidden:
            return f"To see whether it is {_words_of(one.name)}, {_asked(recording, [one.name])}."
    return f"To see whether it is “{possible[0].title}”, {possible[0].proof}." if possible else _OTHERWISE


def _words_of(effect: str) -> str:
    return effect.replace("_", " ")


def _asked(recording: Recording, names: Iterable[str]) -> str:
    """Return the motion that shows effects, with the channels that they need and that were not recorded."""
    effects = list(map(effect_named, names))
    motions = ", and ".join(dict.fromkeys(effect.excitation for effect in effects))
    needed = dict.fromkeys(channel for effect in effects for channel in effect.channels)
    missing = [words_of(channel) for channel in needed if getattr(recording, channel) is None]
    return f"{motions}, with the {' and '.join(missing)} recorded" if missing else motions
