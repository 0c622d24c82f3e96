"""Samples around each one, in time or on the sphere."""

import numpy as np

from tam_calibration.units import FloatArray

MOST_NEIGHBOURS = 20_000
"""Samples among which neighbours on the sphere are sought; as many lie a degree from each other."""


def sum_around(values: FloatArray, span: int) -> FloatArray:
    """Return the sums (N, ...) of values (N, ...) over so many samples on either side, the sample itself left out."""
    padding = [(span + 1, span), *[(0, 0)] * (values.ndim - 1)]
    total = np.cumsum(np.pad(values, padding), axis=0)
    around: FloatArray = total[2 * span + 1 :] - total[: -2 * span - 1] - values
    return around
