"""Whether all sensors have changed faster than stated, where a few changes explain as well what contradicts a prior.

A narrow turn tells few directions well. What contradicts a prior along those may be one bias, or all sensors have
warmed while no temperature was recorded: then what the turn does not tell has changed too. The evidence often leaves
both possible, and the standard errors hold for both (the law of total variance).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logsumexp

from tam_calibration.fit.contradiction import UNNOTICED, Change, Difference, Hypothesis, is_everything, log_odds
from tam_calibration.fit.prior import Prior
from tam_calibration.model.change_rates import DAY_S

_TIMES = (3.0, 10.0, 30.0)
"""The random walk of so many times what a day brings, the temperature of so many kelvins, or both."""

_LOG_FASTER = float(np.log(0.05))
"""Logarithm of the probability, before any reading, that rates are stated too small."""

_LEAST = 1e-3
"""Probability below which the standard errors would stay the same."""


class Faster(NamedTuple):
    """The probability that all errors changed faster than stated, and the prior that allows for it."""

    probability: float
    prior: Prior


def faster_changes(difference: Difference, prior: Prior, found: Sequence[Sequence[Change]]) -> Faster | None:
    """Return how probable it is that all errors changed faster than stated; None where it counts for nothing.

    Parameters
    ----------
    difference : Difference
        Of data and prior.
    prior : Prior
        As it was given, with its rates.
    found : sequence of sequence of Change
        Changes that explain the difference, each with its rivals after it; none where there is no contradiction.
    """
    if prior.rates is None or any(is_everything(change) for change, *_ in found):
        return None
    few, left = 0.0, difference
    for change, *_ in found:
        few += left.evidence(change) + log_odds(change) + np.log(UNNOTICED)
        left = left.without(change)
    _, directions = prior.in_convention(prior.errors)
    every = Hypothesis("all errors", "", 0, directions, (), "")
    sizes = [size for times in _TIMES for size in ((times, 0.0), (0.0, times), (times, times))]
    variances = np.array([prior.rates.variances(walk**2 * DAY_S, warming_K) for walk, warming_K in sizes])
    variances = np.tile(variances, prior.errors.sensor_count)
    evidence = np.array([difference.evidence(Change(every, directions, variance)) for variance in variances])
    total = float(logsumexp(evidence))
    probability = float(expit(_LOG_FASTER + total - np.log(len(sizes)) - few))
    if probability < _LEAST:
        return None
    return Faster(probability, prior.widened(directions, np.exp(evidence - total) @ variances))
