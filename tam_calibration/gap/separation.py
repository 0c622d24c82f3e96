"""The recording that tells two hypotheses apart."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from math import ceil

from tam_calibration.effects.effect import Effect
from tam_calibration.gap.candidates import Candidate, Setting, candidates, expected_evidence
from tam_calibration.gap.evidence import CHANNEL_NAMES, Evidence
from tam_calibration.gap.hypothesis import Hypothesis, places_of
from tam_calibration.gap.model import Model, Part
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Cause, Verdict
from tam_calibration.gap.search import Search
from tam_calibration.gap.support import LEAST_EVIDENCE
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


def _fitted(base: Base, form: Hypothesis) -> Part:
    moved = form.moved(base.channels.covariates)
    projected = base.project(base.channels.design(moved.terms))
    return replace(Part.of(moved), values=projected.inverse()[0] @ projected.score)


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
