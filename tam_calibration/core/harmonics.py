"""Harmonic functions: real spherical harmonics of directions, and potentials that grow with a power of the distance."""

from functools import cache
from math import comb, factorial

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from tam_calibration.model.units import FloatArray


def harmonics(direction: FloatArray, highest: int) -> FloatArray:
    """Return the real spherical harmonics of directions, orthonormal.

    Parameters
    ----------
    direction : (N, 3) array
        Unit vectors.
    highest : int
        Highest degree.

    Returns
    -------
    (N, (highest + 1)²) array
        Orders -l to l of each degree l from 0.
    """
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


def derivatives(degree: int) -> list[tuple[int, int, int]]:
    """Return the orders in x, y, z of the 2 degree + 1 derivatives of a potential that determine it: z at most once."""
    return [(degree - z - y, y, z) for z in (0, 1) for y in range(degree - z + 1)]


def fields(degree: int, position_m: FloatArray) -> FloatArray:
    """Return the fields of harmonic potentials of a degree at given positions, per unit.

    The potential of one of ``derivatives`` is the one whose derivative of that order is 1 and whose others are 0: that
    of x^a y^b z^c / (a! b! c!) for c = 0 or 1 is continued in z by Laplace's equation, as Σ (-1)^k z^(2k+c) / (2k+c)!
    (∂²/∂x² + ∂²/∂y²)^k x^a y^b / (a! b!). Units are T/m^(degree - 1).

    Parameters
    ----------
    degree : int
        Of the potentials, at least 1: 1 is a uniform field, 2 a uniform gradient.
    position_m : (3, N) array
        Where the fields are asked for, metres.

    Returns
    -------
    (2 degree + 1, 3, N) array
        Field of each potential in the order of ``derivatives``.
    """
    power = np.stack([position_m**exponent / factorial(exponent) for exponent in range(degree)])
    products = np.stack([power[x, 0] * power[y, 1] * power[z, 2] for x, y, z in _monomials(degree)])
    return np.asarray((_coefficients(degree) @ products).reshape(2 * degree + 1, 3, -1))


def _monomials(degree: int) -> list[tuple[int, int, int]]:
    """Return the orders in x, y, z of the products of powers in fields."""
    return [(degree - 1 - y - z, y, z) for z in range(degree) for y in range(degree - z)]


@cache
def _coefficients(degree: int) -> FloatArray:
    """Return how fields (2 degree + 1, 3), as one axis, are made of the products of powers over their factorials."""
    number = {orders: place for place, orders in enumerate(_monomials(degree))}
    coefficients = np.zeros((2 * degree + 1, 3, len(number)))
    for own, (along_x, along_y, along_z) in zip(coefficients, derivatives(degree), strict=True):
        for twice in range((along_x + along_y) // 2 + 1):
            for in_x in range(twice + 1):
                orders = np.array([along_x - 2 * in_x, along_y - 2 * (twice - in_x), along_z + 2 * twice])
                for axis, (x, y, z) in enumerate((orders - np.eye(3, dtype=int)).tolist()):
                    if min(x, y, z) >= 0:
                        own[axis, number[x, y, z]] += (-1) ** twice * comb(twice, in_x)
    return coefficients.reshape(-1, len(number))
