"""Sums of outer products: what every fit spends its time on."""

import numpy as np

from tam_calibration.units import FloatArray

_SMALL_PRODUCT = 900_000
"""Multiplications up to which OpenBLAS does a product without packing: above, as for A Aᵀ, it takes thrice as long."""


def gram(columns: FloatArray) -> FloatArray:
    """Return the (M, M) sum of the outer products of the columns (M, N)."""
    width, count = columns.shape
    total = np.zeros((width, width))
    size = max(1, _SMALL_PRODUCT // width**2)
    for start in range(0, count, size):
        part = columns[:, start : start + size]
        total[:-1] += part[:-1] @ part.T
    total[-1, :-1] = total[:-1, -1]
    total[-1, -1] = columns[-1] @ columns[-1]
    return total
