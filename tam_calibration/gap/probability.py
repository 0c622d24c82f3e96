"""The probabilities of the hypotheses, as often right as they say on simulated recordings.

BIC takes the bases for exact, and would call nearly every answer certain. How often an answer of a kind is right was
counted on recordings of the blind check whose seeds are set apart for tuning; a judged run shows how well it holds.
"""

from collections.abc import Mapping
from math import exp

from tam_calibration.gap.result import Verdict
from tam_calibration.gap.standing import LEAST_EVIDENCE
from tam_calibration.gap.steps import Search

_RIGHT: Mapping[Verdict, float] = {
    "no_gap": 0.96,
    "explained": 0.98,
    "partly_explained": 0.7,
    "unexplained": 0.93,
}
"""How often an answer with much evidence is right."""

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
