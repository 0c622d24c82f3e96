"""Normal equations of least squares: sums of outer products, which add up over samples, and their solution."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.units import FloatArray

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


_RIDGE = 1e-9
"""Part of the mean information that is added in each direction: above rounding, and below all that data tell."""


def ridged(information: FloatArray) -> FloatArray:
    """Return information matrices (..., P, P) with a ridge, too small to be seen in directions that the data tell.

    Of matrices that are zero it makes some that are not, so that what has no score gets no value.
    """
    mean = np.asarray(np.trace(information, axis1=-2, axis2=-1) / information.shape[-1])
    size = np.where(mean > 0, mean, 1.0)
    added: FloatArray = information + _RIDGE * size[..., None, None] * np.eye(information.shape[-1])
    return added


@dataclass(frozen=True, eq=False)
class Normal:
    """Normal equations: information matrix (P, P), score (P,), energy of the channels and their number."""

    information: FloatArray
    score: FloatArray
    energy: float
    count: float

    def __add__(self, other: "Normal") -> "Normal":
        """Return the normal equations of both sets of samples."""
        return Normal(
            self.information + other.information,
            self.score + other.score,
            self.energy + other.energy,
            self.count + other.count,
        )

    def __sub__(self, other: "Normal") -> "Normal":
        """Return the normal equations without a part of the samples."""
        return Normal(
            self.information - other.information,
            self.score - other.score,
            self.energy - other.energy,
            self.count - other.count,
        )
