"""What else may have changed since a prior than what is named, and how much less certain the prior is by that.

A narrow turn tells few directions well. What contradicts a prior along those may be one bias, or all sensors have
warmed while no temperature was recorded, a sensor was replaced, or the vehicle carries other iron: then what the turn
does not tell has changed too. The readings often leave both possible. The prior is therefore less certain by each such
change times its probability, as the law of total variance has it.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tam_calibration.correction.update import ALL_BIASES, KINDS, SEVERAL, in_words
from tam_calibration.fit.contradiction import UNNOTICED, Change, Difference, Hypothesis, is_everything, log_odds
from tam_calibration.fit.prior import Prior
from tam_calibration.model.change_rates import DAY_S
from tam_calibration.model.units import FloatArray

_LOG_FASTER = float(np.log(0.05))
"""Logarithm of the probability, before any reading, that rates are stated too small."""

_TIMES = (3.0, 10.0, 30.0)
"""The random walk of so many times what a day brings, the temperature of so many kelvins, or both."""

_LOG_MORE = 0.0
"""Logarithm of the odds, before any reading, that more has changed with what is named: as likely as not."""

_MOST_LOG_ODDS = 50.0
"""From which a probability is one, and its odds are still a number."""

_PARTS = (1.0, 0.3, 0.1, 0.03)
"""Of the size of what is named, that others may have changed by."""

_MATRIX = [0, 1, 2, 3, 4, 5, 9, 10, 11]
"""Places of the errors that multiply the field among the twelve of a sensor."""


class Unnamed(NamedTuple):
    """What may have changed beside what is named, its probability, and what it adds to the prior's covariance."""

    name: str
    probability: float
    covariance: FloatArray


def unnamed_changes(difference: Difference, prior: Prior, found: Sequence[Sequence[Change]]) -> list[Unnamed]:
    """Return what may have changed beside, or instead of, the changes that are named.

    Parameters
    ----------
    difference : Difference
        Of data and prior.
    prior : Prior
        As it was given, with its rates.
    found : sequence of sequence of Change
        Changes that explain the difference, each with its rivals after it; none where there is no contradiction.
    """
    if any(is_everything(change) for change, *_ in found):
        return []
    few, left = 0.0, difference
    for change, *_ in found:
        few += left.evidence(change) + log_odds(change) + np.log(UNNOTICED)
        left = left.without(change)
    unnamed = [_more(left, change, prior) for change, *_ in found if _goes_with_more(change)]
    return unnamed if prior.rates is None else [*unnamed, _faster(difference, prior, few)]


def _goes_with_more(change: Change) -> bool:
    return change.hypothesis.parameters in (*KINDS, ALL_BIASES)


def _more(left: Difference, change: Change, prior: Prior) -> Unnamed:
    """Return what often changes with what is named: all errors of a sensor; iron with the biases of all."""
    sensors = prior.errors.sensor_count
    every = np.eye(12 * sensors).reshape(-1, sensors, 12)
    if change.hypothesis.parameters == ALL_BIASES:
        name, directions, scaled = "soft iron of the vehicle", every[:, :, _MATRIX].sum(axis=1), np.ones(9, dtype=bool)
    else:
        sensor = change.hypothesis.sensor
        name, directions, scaled = in_words(SEVERAL, sensor), every[:, sensor - 1], np.isin(np.arange(12), _MATRIX)
    intensity_T = prior.calibration.intensity_T
    size_T = np.sqrt(np.mean(change.estimate**2)) * (1.0 if "bias" in change.hypothesis.parameters else intensity_T)
    variances = np.square(np.outer(_PARTS, size_T * np.where(scaled, 1 / intensity_T, 1.0)))
    return _weighed(name, left, prior, directions, variances, _LOG_MORE)


def _faster(difference: Difference, prior: Prior, few: float) -> Unnamed:
    """Return that all errors changed faster than stated, beside a few changes of a given logarithm of the evidence."""
    assert prior.rates is not None
    sizes = [size for times in _TIMES for size in ((times, 0.0), (0.0, times), (times, times))]
    rates = np.array([prior.rates.variances(walk**2 * DAY_S, warming_K) for walk, warming_K in sizes])
    variances = np.tile(rates, prior.errors.sensor_count)
    every = np.eye(variances.shape[1])
    return _weighed("all errors, faster than stated", difference, prior, every, variances, _LOG_FASTER - few)


def _weighed(
    name: str, difference: Difference, prior: Prior, directions: FloatArray, variances: FloatArray, log_odds: float
) -> Unnamed:
    """Return a change of several possible sizes, by the evidence of each; sizes (S, M) are variances of M unknowns."""
    _, derivative = prior.in_convention(prior.errors)
    directions = derivative @ directions
    changes = [Change(Hypothesis(name, SEVERAL, 0, directions, (), ""), directions, variance) for variance in variances]
    evidence = np.array([difference.evidence(change) for change in changes])
    total = float(np.logaddexp.reduce(evidence))
    odds = np.exp(min(log_odds + total - np.log(len(changes)), _MOST_LOG_ODDS))
    probability = float(odds / (1 + odds))
    variance = probability * np.exp(evidence - total) @ variances
    return Unnamed(name, probability, directions * variance @ directions.T)
