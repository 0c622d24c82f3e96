"""The International Geomagnetic Reference Field, 14th generation (IAGA, doi:10.5281/zenodo.14012302).

Its potential is a sum of solid harmonics, summed here with the recursions of Cunningham (Celestial Mechanics 2, 1970),
which hold at the poles as well. ``IGRF14.shc`` is IAGA's file: Gauss coefficients, nT, of every fifth year.
"""

from datetime import date
from functools import cache
from math import factorial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

_Coefficients = NDArray[np.complex128]

_FILE = Path(__file__).with_name("IGRF14.shc")
_DEGREE = 13

_REFERENCE_RADIUS_M = 6371.2e3
"""Of the sphere to which the coefficients refer."""

_EQUATORIAL_RADIUS_M, _ECCENTRICITY_SQUARED = 6378137.0, 0.00669437999014
"""Of the ellipsoid WGS84."""


def igrf_T(latitude_deg: float, longitude_deg: float, height_m: float, day: date) -> FloatArray:
    """Return the field at a place and day; between two sets of coefficients it is linear in time.

    Parameters
    ----------
    latitude_deg, longitude_deg : float
        Geodetic latitude, and longitude east, degrees.
    height_m : float
        Above the ellipsoid WGS84, metres.
    day : date
        Day of the field, 1900 to 2029.

    Returns
    -------
    (3,) array
        Components east, north, up, tesla.
    """
    latitude, longitude = from_degrees(latitude_deg), from_degrees(longitude_deg)
    east = np.array([-np.sin(longitude), np.cos(longitude), 0.0])
    up = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    across_m = _EQUATORIAL_RADIUS_M / np.sqrt(1 - _ECCENTRICITY_SQUARED * np.sin(latitude) ** 2)
    position_m = up * (across_m + height_m - np.array([0.0, 0.0, _ECCENTRICITY_SQUARED * across_m]))
    field_nT = _field(position_m, _coefficients(day))
    return from_nanotesla(np.array([east, np.cross(up, east), up]) @ field_nT)


def _field(position_m: FloatArray, coefficients: _Coefficients) -> FloatArray:
    """Return the (3,) field, minus the gradient of the potential, along the axes of the Earth."""
    solid = _solid_harmonics(position_m)
    field = np.zeros(3)
    for degree in range(1, _DEGREE + 1):
        for order in range(degree + 1):
            above = solid[degree + 1]
            rising = -above[order + 1]  # the derivatives along x + iy, x - iy and z, times the reference radius
            falling = (degree - order + 2) * (degree - order + 1) * above[order - 1] if order else rising.conjugate()
            along_z = -(degree - order + 1) * above[order]
            gradient = np.array([(rising + falling) / 2, (rising - falling) / 2j, along_z])
            field -= (coefficients[degree, order] * gradient).real
    return field


def _solid_harmonics(position_m: FloatArray) -> _Coefficients:
    """Return (a/r)ⁿ⁺¹ Pₙₘ(sin φ) exp(imλ), with a the reference radius, by degree n and order m."""
    squared = _REFERENCE_RADIUS_M**2 / float(position_m @ position_m)
    x, y, z = (squared * position_m / _REFERENCE_RADIUS_M).tolist()
    solid = np.zeros((_DEGREE + 2, _DEGREE + 2), dtype=complex)
    solid[0, 0] = np.sqrt(squared)
    for order in range(_DEGREE + 2):
        if order:
            solid[order, order] = (2 * order - 1) * complex(x, y) * solid[order - 1, order - 1]
        for degree in range(order + 1, _DEGREE + 2):
            one, two = solid[degree - 1, order], solid[degree - 2, order] if degree > order + 1 else 0.0
            raised = (2 * degree - 1) * z * one - (degree + order - 1) * squared * two
            solid[degree, order] = raised / (degree - order)
    return solid


def _coefficients(day: date) -> _Coefficients:
    """Return g - ih in nT by degree and order, without the normalisation of Schmidt."""
    days, sets = _published()
    later = int(np.searchsorted(days, day.toordinal(), side="right"))
    passed = (day.toordinal() - days[later - 1]) / (days[later] - days[later - 1])
    interpolated: _Coefficients = (1 - passed) * sets[later - 1] + passed * sets[later]
    return interpolated


@cache
def _published() -> tuple[list[int], _Coefficients]:
    """Return the days of the T sets of coefficients and their values (T, degrees, orders)."""
    lines = [line.split() for line in _FILE.read_text(encoding="ascii").splitlines() if not line.startswith("#")]
    days = [date(int(float(year)), 1, 1).toordinal() for year in lines[1]]
    sets = np.zeros((len(days), _DEGREE + 1, _DEGREE + 1), dtype=complex)
    for line in lines[2:]:
        degree, order, values = int(line[0]), int(line[1]), np.array([float(value) for value in line[2:]])
        sets[:, degree, abs(order)] += (1 if order >= 0 else -1j) * _schmidt(degree, abs(order)) * values
    return days, sets


def _schmidt(degree: int, order: int) -> float:
    """Return the factor of the quasi-normalisation of Schmidt."""
    return float(np.sqrt((2 if order else 1) * factorial(degree - order) / factorial(degree + order)))
