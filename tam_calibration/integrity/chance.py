"""Whether equal readings may be chance."""

from math import log

SURE = 1e-6
"""Chance that sound readings are taken for faulty ones, in a whole recording."""


def is_chance(equal: int, share: float, count: int) -> bool:
    """Whether so many equalities in a row may happen by chance.

    Parameters
    ----------
    equal : int
        Number of equalities in a row.
    share : float
        Chance of one equality, above 0: how often it happens elsewhere.
    count : int
        Number of samples, at each of which the row may begin.
    """
    return share >= 1 or equal * log(share) > log(SURE / count)
