"""Real spherical harmonics of directions."""

from functools import cache
from math import factorial

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from tam_calibration.units import FloatArray


def harmonics(direction: FloatArray, highest: int) -> FloatArray:
    """Return the real spherical harmonics (N, (highest + 1)²), orders -l to l of each degree l, orthonormal."""
    x, y, z = direction.T
    orders = np.concatenate([np.arange(-degree, degree + 1) for degree in range(highest + 1)])
    power = np.cumprod(np.column_stack([np.ones(len(x)), *[x + 1j * y] * highest]), axis=1)
    around = np.concatenate([power.imag[:, :0:-1], power.real], axis=1)
    along: FloatArray = np.vander(z, highest + 1, increasing=True) @ _along_axis(highest)
    along *= around[:, orders + highest]
    return along


@cache
def _along_axis(highest: int) -> FloatArray:
    """Return the polynomials in z, (highest + 1, (highest + 1)²) coefficients, of the harmonics."""
    columns = []
    for degree in range(highest + 1):
        for order in range(-degree, degree + 1):
            size = abs(order)
            ratio = factorial(degree - size) / factorial(degree + size)
            norm = np.sqrt((2 * degree + 1) / (4 * np.pi) * ratio * (2 if order else 1))
            own = norm * Legendre.basis(degree).deriv(size).convert(kind=Polynomial).coef
            columns.append(np.pad(own, (0, highest + 1 - len(own))))
    return np.column_stack(columns)
