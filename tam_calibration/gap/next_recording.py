"""What to record next: the recording that separates two hypotheses, or shows an effect that this one cannot."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from math import ceil

from numpy.linalg import LinAlgError

from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.gap.candidates import Candidate, Setting, candidates, expected_evidence, visible_part
from tam_calibration.gap.hypothesis import Hypothesis, places_of
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Cause, Verdict
from tam_calibration.gap.search import Search
from tam_calibration.gap.size import CHANNEL_NAMES, Evidence
from tam_calibration.gap.support import LEAST_EVIDENCE
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import ALL

_LONGEST_MIN = 60.0
"""Minutes for which people may be asked to record."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The recording that tells two hypotheses apart.

    Parameters
    ----------
    first, second : Part
        The hypotheses as they fit the recording at hand; where one holds the other, the first.
    now : float
        Evidence between them in the recording at hand, twice the log-likelihood ratio.
    gained : float
        What is expected of the recording: the smaller of that for the first, were it true, and for the second.
    candidate : Candidate
        What to do.
    minutes : float
        How long.
    channels : tuple of str
        Names of the fields of ``Recording`` that the hypotheses need.
    """

    first: Part
    second: Part
    now: float
    gained: float
    candidate: Candidate
    minutes: float
    channels: tuple[str, ...]

    @property
    def sentence(self) -> str:
        """What to record."""
        first, second = (words_of(part.effect.name) for part in (self.first, self.second))
        if self.now + self.gained < LEAST_EVIDENCE:
            return (
                f"What was found of {first} and {second} differs so little that no recording of an hour would tell "
                "them apart: the simpler one will do."
            )
        return (
            f"To tell {first} from {second}, {self.candidate.words}, {duration(self.minutes)}"
            f"{with_channels(self.channels)}. The evidence that tells them apart (twice the logarithm of the "
            f"likelihood ratio) is {self.now:.0f} in this recording and would be about "
            f"{rounded(self.now + self.gained)} after it; above {LEAST_EVIDENCE:.0f} decides."
        )


@dataclass(frozen=True, eq=False)
class Ambiguity:
    """Two hypotheses that explain the data nearly alike, and the model without either."""

    first: Evidence
    second: Evidence
    beside: Model


def ambiguity_of(found: Search, verdict: Verdict, causes: Sequence[Cause]) -> Ambiguity | None:
    """Return the first cause that another effect comes near, or the two best effects where none is a cause.

    Parameters
    ----------
    found : Search
        Causes, and the evidence for the other effects at each step.
    verdict : str
        Of the diagnosis.
    causes : sequence of Cause
        The largest share first; empty where the verdict names none.
    """
    if verdict == "unexplained":
        ranked = sorted(found.weighed, key=lambda one: -one.delta_bic)[:2]
        if len(ranked) < 2 or ranked[1].delta_bic < max(LEAST_EVIDENCE, ranked[0].delta_bic - LEAST_EVIDENCE):
            return None
        return Ambiguity(ranked[0], ranked[1], found.nominal)
    named = {cause.fitted.effect for cause in causes}
    linear = [step for step in found.steps if isinstance(step.accepted.form, Hypothesis)]
    for cause in causes:
        step = next(step for step in found.steps if step.accepted.effect == cause.fitted.effect)
        close = [one for one in step.weighed if one.effect not in named and _is_close(step.accepted, one)]
        if close:
            others = [part for own, part in zip(linear, found.model.parts, strict=True) if own is not step]
            second = max(close, key=lambda one: one.delta_bic)
            return Ambiguity(step.accepted, second, replace(found.model, parts=tuple(others)))
    return None


def _is_close(accepted: Evidence, other: Evidence) -> bool:
    """Whether another effect explains nearly as much at the same sensors."""
    if accepted.is_certain:
        return False
    here, there = ({sensor for sensor, _ in places_of(one.form)} for one in (accepted, other))
    if not here & there and ALL not in here | there:
        return False
    return other.delta_bic > max(LEAST_EVIDENCE, accepted.delta_bic - LEAST_EVIDENCE)


def separate(setting: Setting, ambiguity: Ambiguity) -> Separation | None:
    """Return the recording that tells two hypotheses apart; None where one of them is not found by regression.

    Parameters
    ----------
    setting : Setting
        The recording at hand.
    ambiguity : Ambiguity
        The two hypotheses, and the model without either.
    """
    pair = (ambiguity.first, ambiguity.second)
    forms = [one.form for one in pair if isinstance(one.form, Hypothesis)]
    if len(forms) < 2:
        return None
    # Each gains as much as its rank from noise alone.
    beyond = [one.gain - form.selection.rank for one, form in zip(pair, forms, strict=True)]
    now = abs(beyond[0] - beyond[1])
    if forms[1].effect.name in forms[0].effect.limit_of:
        forms.reverse()
    is_nested = forms[0].effect.name in forms[1].effect.limit_of
    base = ambiguity.beside.base()
    first, second = (_fitted(base, form) for form in forms)
    needed = channels_of([first.effect, second.effect])
    offers = [
        (expected_evidence(setting, first, second, offer, is_nested), offer)
        for offer in candidates(setting.covariates, needed)
    ]
    offers.append((now, Candidate("make the same motion for as long again", "onwards", 0.0, setting.minutes)))
    gained, best = max(offers, key=lambda offer: offer[0] / offer[1].minutes)
    minutes = long_enough(gained, best.minutes)
    return Separation(first, second, now, gained * minutes / best.minutes, best, minutes, needed)


def channels_of(effects: Iterable[Effect]) -> tuple[str, ...]:
    """Return the fields of ``Recording`` that effects need."""
    return tuple(dict.fromkeys(channel for effect in effects for channel in effect.channels))


def with_channels(channels: Collection[str]) -> str:
    """Return at which rate and with which channels to record, in words."""
    names = " and ".join(CHANNEL_NAMES[channel] for channel in channels)
    return f" at the same rate, with the {names} recorded" if names else " at the same rate"


def words_of(effect: str) -> str:
    """Return what people call an effect."""
    return effect.replace("_", " ")


def long_enough(gained: float, minutes: float) -> float:
    """Return how many minutes bring twice the evidence that decides, where some bring so much; an hour at most.

    Parameters
    ----------
    gained : float
        Evidence that so many minutes bring, twice the log-likelihood ratio.
    minutes : float
        Duration of the recording that brings it, returned as it is where nothing is gained.
    """
    if gained <= 0:
        return minutes
    return min(minutes * max(ceil(2 * LEAST_EVIDENCE / gained), 1), max(_LONGEST_MIN, minutes))


def duration(minutes: float) -> str:
    """Return how long to record, in words."""
    return f"for {60 * minutes:.0f} s" if minutes < 1.5 else f"for {minutes:.0f} min"


def rounded(evidence: float) -> str:
    """Return an evidence with no more figures than a simulation tells."""
    return f"{evidence:.0f}" if evidence < 100 else f"{float(f'{evidence:.2g}'):.0f}"


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
    if matched := [one.fitted.effect for one in causes if one.surrogate_test and one.surrogate_test.is_matched]:
        return (
            f"Let the channel of {matched[0].replace('_', ' ')} rise and fall several times in the run: in this one "
            "any other slow drift explains as much."
        )
    if verdict == "explained":
        hidden = _hidden(found, causes, missing)
        return (hidden and _shown(setting, *hidden)) or _CONFIRMED
    rest = found.rivals if verdict == "unexplained" else found.remaining
    strong = [one for one in rest if one.delta_bic > LEAST_EVIDENCE and one.effect in _OTHERWISE]
    unknown = max(strong, key=lambda one: one.delta_bic, default=None)
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


def _fitted(base: Base, form: Hypothesis) -> Part:
    return Part.at(base, form.moved(base.channels.covariates))


def _hidden(found: Search, causes: Sequence[Cause], missing: Collection[str]) -> tuple[Evidence, list[str]] | None:
    """Return a cause that may be another effect which this recording cannot show, and the names of such effects."""
    drift = next((one.gain for one in found.rivals if one.effect == "function_of_time"), 0.0)
    named = {cause.fitted.effect for cause in causes}
    for accepted in (step.accepted for step in found.steps if step.accepted.effect in named):
        effect = effect_named(accepted.effect)
        others = [name for name in (*getattr(effect, "limit_of", ()), *effect.may_be) if name in missing]
        is_sharp = isinstance(effect, LinearEffect) and effect.is_step and drift < accepted.gain - LEAST_EVIDENCE
        if others and not is_sharp:
            return accepted, others
    return None


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
