"""Chance, by permutation: the same statistic where residuals are dealt out anew among samples of like motion.

What has nothing to do with the path of the field explains as much with the residuals of other samples that move as
fast; what follows the path, in its direction and size, does not (Good, Permutation, Parametric and Bootstrap Tests of
Hypotheses, Springer, 2005).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from tam_calibration.units import FloatArray

PERMUTATIONS = 200
"""How often residuals are dealt out anew: what none of them reaches is chance once in 201 times."""

_ALIKE = 200
"""Samples, in the order of their rates, among which residuals are dealt out."""

Statistic = Callable[[NDArray[np.intp]], float]
"""A number that is large where a law holds, from whose residual (N,) each sample has."""


def is_chance(statistic: Statistic, rate: FloatArray) -> bool:
    """Return whether any permutation within samples of like rate (N,) reaches the statistic."""
    generator, dealt = np.random.default_rng(0), np.arange(len(rate))
    size = min(_ALIKE, len(rate))
    blocks = np.argsort(rate)[len(rate) % size :].reshape(-1, size)  # without a few of the slowest
    observed = statistic(dealt)
    for _ in range(PERMUTATIONS):
        near = generator.permuted(blocks, axis=1)
        dealt[near[:, 1:]], dealt[near[:, 0]] = near[:, :-1], near[:, -1]  # in a cycle: no sample keeps its own
        if statistic(dealt) >= observed:
            return True
    return False
