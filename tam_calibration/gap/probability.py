"""The probabilities of the answers, from what each case shows.

How often a cause is right follows from how far what is left stands above the smallest gap that would have been seen,
from the cause's share, and from how much more speaks for it than for what was not named: a logistic regression on
recordings with known causes. No gap, and an unknown cause, are as likely as they were right there. The coefficients are
those that

    python benchmarks/gap_probabilities.py FOLDER ...

prints, of folders that ``tam blind make`` or a world of others wrote and ``tam blind answer`` answered: 724 causes of
250 cases of ``--seed 815`` and of 600 of an earlier judgement, ``--seed 20261240``, read since.
"""

from collections.abc import Collection, Mapping, Sequence
from math import exp, log

from tam_calibration.effects.grades import SLIGHT
from tam_calibration.gap.result import Cause, Size, Verdict
from tam_calibration.gap.shares import energies_of
from tam_calibration.gap.steps import Search
from tam_calibration.gap.support import LEAST_EVIDENCE

_COEFFICIENTS = (0.31, -0.63, 2.99, 0.8)
"""Of one, of the logarithm of what is left over the smallest visible gap, of the share, and of the odds of evidence."""

_RIGHT: Mapping[Verdict, float] = {"no_gap": 98 / 100, "unexplained": 141 / 148}
"""How often these were right: 97 of 98 and 140 of 146, by Laplace's rule."""

_NAMES = {"none_of_these": "unknown"}


def probabilities(found: Search, verdict: Verdict, size: Size, smallest: float) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect that was weighed, and of none of these.

    They add up to one; where there are several causes each has a probability of its own. The smallest gap is the one
    that would have been seen.
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
        own = right(features_of(size.after, smallest, share, step.accepted.delta_bic, rival))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = rest / 2
    _spread(chances, found, named, rest / 2)
    return chances


def right(features: Sequence[float]) -> float:
    """Return the probability that a cause is right, by the logistic regression."""
    return 1 / (1 + exp(-sum(w * value for w, value in zip(_COEFFICIENTS, features, strict=True))))


def features_of(
    after: float, smallest: float, share: float, own: float, rival: float
) -> tuple[float, float, float, float]:
    """Return what the probability of a cause is made of, in the order of the coefficients.

    Parameters
    ----------
    after, smallest : float
        Gap that is left, and the smallest that would have been seen, in noise floors.
    share : float
        Of the cause in what closes.
    own, rival : float
        ΔBIC of the cause, and the largest of the effects that were not named.
    """
    rest = log(max(after, smallest) / smallest)
    return 1.0, rest, share, log(max(own, LEAST_EVIDENCE) / max(rival, LEAST_EVIDENCE))


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
