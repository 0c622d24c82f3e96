"""The probabilities of the answers, from what each case shows.

How often a cause is right follows from how many of the predictive checks what is left fails, from the cause's share,
and from how much more speaks for it than for what was not named: a logistic regression on recordings with known causes.
No gap, and an unknown cause, are as likely as they were right there. The coefficients are those that

    python benchmarks/gap_probabilities.py FOLDER ...

prints, of folders that ``tam blind make`` or a world of others wrote and ``tam blind answer`` answered: 1232 causes of
250 cases of ``--seed 815`` and of 600 of each of two earlier judgements, ``--seed 20261240`` and ``--seed 20261250``,
read since.
"""

from collections.abc import Collection, Mapping, Sequence
from math import exp, log, log1p

from tam_calibration.effects.grades import SLIGHT
from tam_calibration.gap.result import Cause, Verdict
from tam_calibration.gap.shares import energies_of
from tam_calibration.gap.steps import Search
from tam_calibration.gap.support import LEAST_EVIDENCE

_COEFFICIENTS = (1.24, -1.18, 2.0, 0.83)
"""Of one, of the logarithm of one more than the checks that fail, of the share, and of the odds of evidence."""

_RIGHT: Mapping[Verdict, float] = {"no_gap": 167 / 171, "unexplained": 228 / 242}
"""How often these were right: 166 of 169 and 227 of 240, by Laplace's rule."""

_NAMES = {"none_of_these": "unknown"}


def probabilities(found: Search, verdict: Verdict, departures: int) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect that was weighed, and of none of these.

    They add up to one; where there are several causes each has a probability of its own. The departures are the
    predictive checks that fail.
    """
    chances = dict.fromkeys(("no_gap", *(one.effect for one in found.weighed), "none_of_these"), 0.0)
    if verdict in ("no_gap", "unexplained"):
        answer, other = ("no_gap", "none_of_these") if verdict == "no_gap" else ("none_of_these", "no_gap")
        rest = 1 - _RIGHT[verdict]
        chances[answer] = _RIGHT[verdict]
        chances[other] += rest / 2
        _spread(chances, found, (), rest / 2)
        return chances
    energy = energies_of(found.steps, found.nominal.base().channels.count)
    named = tuple({step.accepted.effect: None for step in found.steps})
    rival = max((one.delta_bic for one in found.weighed if one.effect not in named), default=0.0)
    for step in found.steps:
        share = energy[step] / sum(energy.values())
        own = right(features_of(departures, share, step.accepted.delta_bic, rival))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = rest / 2
    _spread(chances, found, named, rest / 2)
    return chances


def right(features: Sequence[float]) -> float:
    """Return the probability that a cause is right, by the logistic regression."""
    return 1 / (1 + exp(-sum(w * value for w, value in zip(_COEFFICIENTS, features, strict=True))))


def features_of(departures: int, share: float, own: float, rival: float) -> tuple[float, float, float, float]:
    """Return what the probability of a cause is made of, in the order of the coefficients.

    Parameters
    ----------
    departures : int
        Predictive checks that what is left fails.
    share : float
        Of the cause in what closes.
    own, rival : float
        ΔBIC of the cause, and the largest of the effects that were not named.
    """
    return 1.0, log1p(departures), share, log(max(own, LEAST_EVIDENCE) / max(rival, LEAST_EVIDENCE))


def set_of(chances: Mapping[str, float], verdict: Verdict, causes: Collection[Cause]) -> tuple[str, ...]:
    """Return the smallest set of answers that holds the true one with 95 %, the most probable first.

    Of several causes the doubts of each are added: the set holds all of them, and what may stand in place of one.
    """
    if verdict == "not_identifiable":
        return ()
    named = [cause.fitted.effect for cause in causes]
    ranked = sorted(chances, key=lambda name: (name not in named, -chances[name]))
    doubt, told = 1.0, []
    for name in ranked:
        told.append(_NAMES.get(name, name))
        if name in named:
            doubt = 1 - min(chances[one] for one in named)
            if len(told) < len(set(named)):
                continue
        else:
            doubt -= chances[name]
        if 1 - doubt >= 1 - SLIGHT:
            break
    return tuple(told)


def _spread(chances: dict[str, float], found: Search, named: Collection[str], rest: float) -> None:
    """Give what remains to the effects that are not named, the more the more speaks for them."""
    gains = {one.effect: max(one.gain, 0.0) for one in found.weighed if one.effect not in named}
    total = sum(gains.values())
    for name, gain in gains.items():
        chances[name] += rest * gain / total if total > 0 else 0.0
