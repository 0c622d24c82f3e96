"""The probabilities of the hypotheses, as often right as they say on simulated recordings.

BIC takes the bases for exact, and would call nearly every answer certain. How often what a verdict says is true was
counted on 200 recordings of the blind check on which nothing was tuned, and is told by

    tam blind make cases --seed 302 --cases 200 && tam blind answer cases && tam blind score cases

Of k in n the probability is (k + 1) / (n + 2) (Laplace's rule). How weak evidence lowers it, and what is left to the
others, is chosen and not counted; a judged run shows how well it holds.
"""

from collections.abc import Mapping
from math import exp

from tam_calibration.gap.result import Verdict
from tam_calibration.gap.steps import Search
from tam_calibration.gap.support import LEAST_EVIDENCE

_RIGHT: Mapping[Verdict, float] = {
    "no_gap": 23 / 24,
    "explained": 122 / 124,
    "partly_explained": 1 / 2,
    "unexplained": 27 / 30,
}
"""How often what a verdict says is true: 22 of 22, 121 of 122, never told, 26 of 28."""

_WEAK, _FADES = 0.2, 40.0
"""By how much less often one is right at the least evidence, and the ΔBIC over which that fades."""

_NONE_OF_REST = 0.4
"""Part of what remains beside a cause that no effect of the library takes."""


def probabilities(found: Search, verdict: Verdict) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect that was weighed, and of none of these.

    They add up to one; where there are several causes each has a probability of its own.
    """
    chances = dict.fromkeys(("no_gap", *(one.effect for one in found.weighed), "none_of_these"), 0.0)
    if verdict not in _RIGHT:
        return {}
    right = _RIGHT[verdict]
    if verdict in ("no_gap", "unexplained"):
        answer, other = ("no_gap", "none_of_these") if verdict == "no_gap" else ("none_of_these", "no_gap")
        chances[answer] = right
        chances[other] = (1 - right) / 4
        _spread(chances, found, (), (1 - right) * 3 / 4)
        return chances
    for step in found.steps:
        beyond = max(step.accepted.delta_bic - LEAST_EVIDENCE, 0.0)
        own = right * (1 - _WEAK * exp(-beyond / _FADES))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    named = tuple({step.accepted.effect: None for step in found.steps})
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = _NONE_OF_REST * rest
    _spread(chances, found, named, (1 - _NONE_OF_REST) * rest)
    return chances


def _spread(chances: dict[str, float], found: Search, named: tuple[str, ...], rest: float) -> None:
    """Give what remains to the effects that are not named, the more the more speaks for them."""
    gains = {one.effect: max(one.gain, 0.0) for one in found.weighed if one.effect not in named}
    total = sum(gains.values())
    for name, gain in gains.items():
        chances[name] += rest * gain / total if total > 0 else 0.0
