"""Rates with their intervals, and how far probabilities are what they say."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt
from statistics import NormalDist

import numpy as np

WITHIN_95 = NormalDist().inv_cdf(0.975)
"""Standard deviations to both sides that hold 95 % of a normal law."""

_BINS = 10
"""Of the reliability curve, each a tenth of the probability."""

_LEAST = 1e-3
"""A probability below counts as this: one that is wrong though certain is no worse than a thousandth."""


@dataclass(frozen=True)
class Rate:
    """How many of how many."""

    hits: int
    cases: int

    @classmethod
    def of(cls, outcomes: Iterable[bool]) -> "Rate":
        """Count."""
        listed = list(outcomes)
        return cls(sum(listed), len(listed))

    @property
    def value(self) -> float:
        """Share of the hits; not a number without cases."""
        return self.hits / self.cases if self.cases else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval (1927, eq. 7 of Brown, Cai and DasGupta 2001)."""
        if not self.cases:
            return 0.0, 1.0
        square = WITHIN_95**2
        middle = (self.hits + square / 2) / (self.cases + square)
        half = WITHIN_95 / (self.cases + square) * sqrt(self.cases * self.value * (1 - self.value) + square / 4)
        return max(0.0, middle - half), min(1.0, middle + half)


@dataclass(frozen=True)
class Bin:
    """Probabilities of about one size: their mean, how often they came true, how many."""

    told: float
    true: float
    count: int


def reliability_curve(forecasts: Sequence[tuple[float, bool]]) -> list[Bin]:
    """Return the curve of what came true over what was told, in bins of equal width that are not empty."""
    values = np.array([value for value, _ in forecasts])
    hits = np.array([hit for _, hit in forecasts], dtype=float)
    index = np.minimum((values * _BINS).astype(int), _BINS - 1)
    groups = [index == number for number in range(_BINS)]
    return [Bin(float(values[one].mean()), float(hits[one].mean()), int(one.sum())) for one in groups if one.any()]


def calibration_error(curve: Sequence[Bin]) -> float:
    """Return the expected calibration error: the mean distance of the curve from the diagonal, by counts."""
    total = sum(one.count for one in curve)
    return sum(one.count * abs(one.told - one.true) for one in curve) / total if total else float("nan")


def log_score(forecasts: Sequence[tuple[float, bool]]) -> float:
    """Return the mean negative logarithm of the probability given to what came true (Good 1952); small is good."""
    given = [value if came else 1 - value for value, came in forecasts]
    return float(-np.log(np.maximum(given, _LEAST)).mean()) if given else float("nan")


def constant_log_score(groups: Iterable[Sequence[bool]]) -> float:
    """Return the log score of who knows of each group how often it came true, (k + 1) / (n + 2), and no more."""
    forecasts = []
    for group in groups:
        value = (sum(group) + 1) / (len(group) + 2)
        forecasts += [(value, came) for came in group]
    return log_score(forecasts)


def separation(forecasts: Sequence[tuple[float, bool]]) -> float:
    """Return how often what came true was given more than what did not, ties by half: the area under the ROC curve."""
    true = np.array([value for value, came in forecasts if came])
    false = np.array([value for value, came in forecasts if not came])
    if not true.size or not false.size:
        return float("nan")
    more = (true[:, None] > false).mean() + (true[:, None] == false).mean() / 2
    return float(more)
