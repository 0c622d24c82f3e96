"""What else may have changed since a prior than what is named, and how much less certain the prior is by that.

A narrow turn shows few directions well. A contradiction along those may come from one bias. It may as well come from
all sensors, which have warmed while no temperature was recorded, from a sensor that was repaired, or from other iron
aboard. Then errors that the turn does not show have changed too. Often the readings leave both possible. The covariance
of the prior therefore grows by that of each such change times its probability (the law of total variance).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from tam_calibration.correction.update import ALL_BIASES, KINDS, SEVERAL, in_words
from tam_calibration.fit.contradiction import Change, Difference, Hypothesis, is_everything, log_odds
from tam_calibration.fit.prior import Prior
from tam_calibration.model.change_rates import DAY_S
from tam_calibration.model.units import FloatArray

_UNNOTICED = 0.01
"""Probability that something moved since the prior by more than its rates of change say."""

_LOG_FASTER = float(np.log(0.05))
"""Logarithm of the probability, before any reading, that rates are stated too small."""

_TIMES = (3.0, 10.0, 30.0)
"""Changes that are tried: so many times the random walk of a day, so many kelvins, or both."""

_LOG_MORE = 0.0
"""Logarithm of the odds, before any reading, that more has changed with what is named: as likely as not."""

_PARTS = (1.0, 0.3, 0.1, 0.03)
"""Sizes that are tried for the other changes, over that of the change that is named."""

_MATRIX = [0, 1, 2, 3, 4, 5, 9, 10, 11]
"""Places of the errors that multiply the field among the twelve of a sensor."""


class Unnamed(NamedTuple):
    """A change that is not named, its probability, and what it adds to the covariance (12 K, 12 K) of the prior."""

    name: str
    probability: float
    covariance: FloatArray


def unnamed_changes(
    difference: Difference,
    prior: Prior,
    found: Sequence[Sequence[Change]],
    candidates: Sequence[Sequence[Change]],
) -> list[Unnamed]:
    """Return what may have changed together with, or instead of, the changes that are named.

    Parameters
    ----------
    difference : Difference
        Of data and prior.
    prior : Prior
        As it was given, with its rates.
    found : sequence of sequence of Change
        Changes that explain the difference, each with its rivals after it; empty where there is no contradiction.
    candidates : sequence of sequence of Change
        What may have changed, each in all sizes, as of ``candidates_of``.
    """
    if any(is_everything(change) for change, *_ in found):
        return []
    few, left = 0.0, difference
    for change, *_ in found:
        few += left.evidence(change) + log_odds(change) + np.log(_UNNOTICED)
        left = left.without(change)
    unnamed = [
        _more(left, change, prior) for change, *_ in found if change.hypothesis.parameters in (*KINDS, ALL_BIASES)
    ]
    if not found:
        unnamed.append(small_changes(difference, candidates))
    return unnamed if prior.rates is None else [*unnamed, _faster(difference, prior, few)]


def small_changes(difference: Difference, candidates: Sequence[Sequence[Change]]) -> Unnamed:
    """Return all changes that are too uncertain to be named.

    Each adds the square of its estimate times its probability: a difference that chance makes once in a thousand
    updates is a small change once in ten.

    Parameters
    ----------
    difference, candidates
        As for ``unnamed_changes``, where nothing was found.
    """
    every = [change for sizes in candidates for change in sizes]
    evidence = np.array([difference.evidence(change) + log_odds(change) for change in every])
    weight = _UNNOTICED / len(every) * np.exp(evidence)
    moved = np.array([change.directions @ difference.estimated(change).estimate for change in every])
    part = weight / (1 + weight.sum())
    return Unnamed("a small change", float(part.sum()), moved.T * part @ moved)


def _more(left: Difference, change: Change, prior: Prior) -> Unnamed:
    """Return what often changes together: all errors of a sensor, or soft iron with the biases of all sensors."""
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
    """Return that all errors changed faster than stated, instead of few changes with that logarithm of the evidence."""
    assert prior.rates is not None
    sizes = [size for times in _TIMES for size in ((times, 0.0), (0.0, times), (times, times))]
    rates = np.array([prior.rates.variances(walk**2 * DAY_S, warming_K) for walk, warming_K in sizes])
    variances = np.tile(rates, prior.errors.sensor_count)
    every = np.eye(variances.shape[1])
    return _weighed("all errors, faster than stated", difference, prior, every, variances, _LOG_FASTER - few)


def _weighed(
    name: str, difference: Difference, prior: Prior, directions: FloatArray, variances: FloatArray, log_prior: float
) -> Unnamed:
    """Return a change of several possible sizes, weighed by the evidence of each.

    The directions (12 K, M) are those of M unknowns, the variances (S, M) those of S sizes.
    """
    _, derivative = prior.in_convention(prior.errors)
    directions = derivative @ directions
    changes = [Change(Hypothesis(name, SEVERAL, 0, directions, (), ""), directions, variance) for variance in variances]
    evidence = np.array([difference.evidence(change) for change in changes])
    total = float(np.logaddexp.reduce(evidence))
    probability = float(np.exp(-np.logaddexp(0.0, np.log(len(changes)) - log_prior - total)))
    variance = probability * np.exp(evidence - total) @ variances
    return Unnamed(name, probability, directions * variance @ directions.T)
