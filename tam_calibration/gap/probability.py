"""The probabilities of the answers, from what each case shows.

How often a cause is right follows from how far it stands above its surrogates, from how much of the gap closes, and
from its share of that: a logistic regression on recordings with known causes. No gap, and an unknown cause, are as
likely as they were right there. The coefficients are those that

    python benchmarks/gap_probabilities.py FOLDER ...

prints, of folders that ``tam blind make`` and ``tam blind answer`` wrote: 56 causes of ``--seed 811 --cases 70``.
"""

from collections.abc import Collection, Mapping
from math import exp, log

from tam_calibration.gap.result import Cause, Size, Verdict
from tam_calibration.gap.standing import Standing
from tam_calibration.gap.steps import Search

_COEFFICIENTS = (-0.22, 0.0, 0.85, 1.2)
"""Of one, of the logarithm of the ratio to the best surrogate, of the closed part and of the share in it."""

_LARGEST_RATIO = 10.0
"""Beyond which a ratio says nothing more; also that of facts of the readings, which need no surrogates."""

_RIGHT: Mapping[Verdict, float] = {"no_gap": 9 / 10, "unexplained": 9 / 17}
"""How often these were right: 8 of 8 and 8 of 15, by Laplace's rule."""

_SURE = 0.95
"""Probability that a set of answers holds the true one."""

_NAMES = {"none_of_these": "unknown"}


def probabilities(found: Search, verdict: Verdict, size: Size) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect that was weighed, and of none of these.

    They add up to one; where there are several causes each has a probability of its own.
    """
    chances = dict.fromkeys(("no_gap", *(one.effect for one in found.weighed), "none_of_these"), 0.0)
    if verdict in ("no_gap", "unexplained"):
        answer, other = ("no_gap", "none_of_these") if verdict == "no_gap" else ("none_of_these", "no_gap")
        rest = 1 - _RIGHT[verdict]
        chances[answer] = _RIGHT[verdict]
        chances[other] += rest / 2
        _spread(chances, found, (), rest / 2)
        return chances
    gains = sum(step.accepted.gain for step in found.steps)
    for step in found.steps:
        own = right(step.standing, size.closed, step.accepted.gain / max(gains, 1e-300))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    named = tuple({step.accepted.effect: None for step in found.steps})
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = rest / 2
    _spread(chances, found, named, rest / 2)
    return chances


def right(standing: Standing | None, closed: float, share: float) -> float:
    """Return the probability that a cause is right, by the logistic regression."""
    logit = sum(w * value for w, value in zip(_COEFFICIENTS, features_of(standing, closed, share), strict=True))
    return 1 / (1 + exp(-logit))


def features_of(standing: Standing | None, closed: float, share: float) -> tuple[float, float, float, float]:
    """Return what the probability of a cause is made of, in the order of the coefficients."""
    ratio = _LARGEST_RATIO if standing is None else min(max(standing.ratio, 1.0), _LARGEST_RATIO)
    return 1.0, log(ratio), closed, share


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
        if doubt <= 1 - _SURE:
            break
    return tuple(told)


def _spread(chances: dict[str, float], found: Search, named: Collection[str], rest: float) -> None:
    """Give what remains to the effects that are not named, the more the more speaks for them."""
    gains = {one.effect: max(one.gain, 0.0) for one in found.weighed if one.effect not in named}
    total = sum(gains.values())
    for name, gain in gains.items():
        chances[name] += rest * gain / total if total > 0 else 0.0
