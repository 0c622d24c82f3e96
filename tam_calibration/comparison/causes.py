"""The causes of a side that are told by their names, how large each is, and the part that nobody knows."""

import numpy as np

from tam_calibration.comparison.result import UNKNOWN, EffectDifference, Side
from tam_calibration.gap.result import Cause

_OPEN = ("partly_explained", "unexplained")
"""Verdicts that leave an unknown part."""

_LIKELY = 0.5
"""Probability below which a cause beside an unknown part is not told: it belongs to that part."""

_UNKNOWN_ALIKE = 0.5
"""Part by which two unknown parts may differ in size and still be one: twice that of runs of one phone, or one IMU."""


def likely_causes(side: Side) -> list[Cause]:
    """Return the causes that are told by their names, all where they explain the recording.

    Parameters
    ----------
    side : Side
        With its diagnosis.
    """
    return [cause for cause in side.gap.causes if side.gap.verdict not in _OPEN or cause.probability >= _LIKELY]


def size_of(cause: Cause, side: Side) -> float:
    """Return the root of the energy that a cause explains, in noise floors.

    Parameters
    ----------
    cause : Cause
        Of the diagnosis.
    side : Side
        That was diagnosed.
    """
    size = side.gap.size
    return float(np.sqrt(max(cause.share * (size.before**2 - size.after**2), 0.0)))


def unknown_part(side: Side) -> EffectDifference | None:
    """Return what no effect explains of a side, or only one that is unlikely; None where nothing is open.

    Parameters
    ----------
    side : Side
        With its diagnosis.
    """
    gap = side.gap
    if gap.verdict not in _OPEN:
        return None
    energy = gap.size.before**2 - sum(size_of(cause, side) ** 2 for cause in likely_causes(side))
    probability = gap.probabilities.get("none_of_these", float("nan"))
    return EffectDifference(UNKNOWN, gap.where.sensors, gap.where.axes, probability, float(np.sqrt(energy)), True)


def are_alike(one: EffectDifference, other: EffectDifference) -> bool:
    """Whether two unknown parts may be the same: of one place, and nearly of one size.

    Parameters
    ----------
    one, other : EffectDifference
        Both unknown.
    """
    small, large = sorted((one.size, other.size))
    return bool(set(one.sensors) & set(other.sensors)) and large - small <= _UNKNOWN_ALIKE * large
