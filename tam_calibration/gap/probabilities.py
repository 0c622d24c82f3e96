"""Probabilities of the answers, the smallest set that contains the true one, and the shares of causes in the gap."""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations
from math import exp, expm1, factorial, log, log1p

import numpy as np

from tam_calibration.effects.grades import SLIGHT
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.gap.laws.law import CHANCE, usual_law
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.result import Cause, Size, Verdict
from tam_calibration.gap.steps import LEAST_EVIDENCE, Search, Step
from tam_calibration.model.units import FloatArray


def energies_of(steps: Sequence[Step], count: float) -> dict[Step, float]:
    """Return the part of the energy that each cause explains of the residual of those accepted before it.

    Parameters
    ----------
    steps : sequence of Step
        Causes in the order in which they were accepted.
    count : float
        Number of whitened channels.

    Returns
    -------
    dict of Step to float
        As a part of the residual energy before the first cause, 0 to 1.
    """
    left, energies = 1.0, {}
    for step in steps:
        energies[step] = left * -expm1(-step.accepted.gain / count)
        left -= energies[step]
    return energies


def shares_of(model: Model) -> FloatArray:
    """Return the Shapley values (M,) of the energy that the parts of a model explain; they add up to one."""
    count = len(model.parts)
    if count < 2:
        return np.ones(count)
    channels = model.channels()
    designs = [channels.design(part.terms(channels)) for part in model.parts]
    projected = Base(channels, [channels.calibration]).project(Regressors.joined(designs))
    ends = np.cumsum([design.width for design in designs])
    columns = [np.arange(end - design.width, end) for end, design in zip(ends, designs, strict=True)]
    explained: dict[tuple[int, ...], float] = {(): 0.0}
    for size in range(1, count + 1):
        for group in combinations(range(count), size):
            explained[group] = projected.take(np.concatenate([columns[member] for member in group])).gain()[0]
    values = np.zeros(count)
    for group, energy in explained.items():
        for member in group:
            others = tuple(other for other in group if other != member)
            weight = factorial(len(others)) * factorial(count - len(group)) / factorial(count)
            values[member] += weight * (energy - explained[others])
    return np.maximum(values, 0) / max(float(np.maximum(values, 0).sum()), np.finfo(float).tiny)


_COEFFICIENTS = (1.93, -0.6, 0.91, 0.19, -1.67)
"""Logistic regression: intercept, log(1 + failing checks), share, log ratio of the evidences, and a law of chance.

``benchmarks/gap_probabilities.py`` fits them: to the 235 causes named in 80 cases of ``tam blind make --seed 771``
and in 220 of ``--seed 20271202 --outside second``.
"""


_RIGHT: Mapping[Verdict, float] = {"no_gap": 35 / 37, "unexplained": 43 / 61}
"""Part of these verdicts that was right in the same cases: 34 of 35 and 42 of 59, by Laplace's rule."""


def probabilities(found: Search, verdict: Verdict, size: Size, departures: int) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect that was weighed, and of none of these.

    They add up to one; of several causes each has a probability of its own.

    Parameters
    ----------
    found : Search
        Causes, and the evidence for every effect at the nominal model.
    verdict : str
        Of the diagnosis.
    size : Size
        Of the gap.
    departures : int
        Number of predictive checks that the residual fails.
    """
    chances = dict.fromkeys(("no_gap", *(one.effect for one in found.weighed), "none_of_these"), 0.0)
    if verdict in ("no_gap", "unexplained"):
        answer, other = ("no_gap", "none_of_these") if verdict == "no_gap" else ("none_of_these", "no_gap")
        # More than noise that exceeds its sheet is a gap.
        rest = 1 - _RIGHT[verdict]
        part = rest if not found.weighed else rest / 2 if size.before**2 < LARGEST_NOISE**2 - 1 else 0.0
        chances[answer] = _RIGHT[verdict]
        chances[other] += part
        _spread(chances, found, (), rest - part)
        return chances
    energy = energies_of(found.steps, found.nominal.base().channels.count)
    named = tuple({step.accepted.effect: None for step in found.steps})
    rival = max((one.delta_bic for one in found.weighed if one.effect not in named), default=0.0)
    for step in found.steps:
        share = energy[step] / sum(energy.values())
        own = right(features_of(step.accepted.effect, departures, share, step.accepted.delta_bic, rival))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = rest / 2
    _spread(chances, found, named, rest / 2)
    return chances


def right(features: Sequence[float]) -> float:
    """Return the probability that a cause is right, by the logistic regression."""
    return 1 / (1 + exp(-sum(w * value for w, value in zip(_COEFFICIENTS, features, strict=True))))


def features_of(effect: str, departures: int, share: float, own: float, rival: float) -> tuple[float, ...]:
    """Return the features of the logistic regression of a cause, in the order of the coefficients.

    What makes noise or single bad readings has no course that would tell it from other causes.

    Parameters
    ----------
    effect : str
        Name of the cause.
    departures : int
        Number of predictive checks that the residual fails.
    share : float
        Of the cause in the energy that all causes explain.
    own, rival : float
        ΔBIC of the cause, and the largest of the effects that were not named.
    """
    ratio = log(max(own, LEAST_EVIDENCE) / max(rival, LEAST_EVIDENCE))
    return 1.0, log1p(departures), share, ratio, float(usual_law(effect) in CHANCE)


def set_of(chances: Mapping[str, float], verdict: Verdict, causes: Collection[Cause]) -> tuple[str, ...]:
    """Return the smallest set of answers that holds the true one with 95 %, the most probable first.

    Of several causes the set holds all, then alternatives to the least probable of them.

    Parameters
    ----------
    chances : mapping of str to float
        As of ``probabilities``.
    verdict : str
        Of the diagnosis.
    causes : collection of Cause
        Those that the verdict names.
    """
    if verdict == "not_identifiable":
        return ()
    named = {cause.fitted.effect for cause in causes}
    ranked = sorted(chances, key=lambda name: -chances[name])
    members = [name for name in ranked if name in named]
    doubt = 1 - min((chances[name] for name in named), default=0.0)
    for name in ranked:
        if members and 1 - doubt >= 1 - SLIGHT:
            break
        if name not in named:
            members.append(name)
            doubt -= chances[name]
    return tuple("unknown" if name == "none_of_these" else name for name in members)


def _spread(chances: dict[str, float], found: Search, named: Collection[str], rest: float) -> None:
    """Distribute the remaining probability over the effects not named by their gains; without any to none of these."""
    gains = {one.effect: max(one.gain, 0.0) for one in found.weighed if one.effect not in named}
    total = sum(gains.values())
    if total == 0:
        chances["none_of_these"] += rest
        return
    for name, gain in gains.items():
        chances[name] += rest * gain / total
