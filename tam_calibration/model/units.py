"""Conversion between SI units and those of files and reports: the only place that converts."""

import re
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]
Quantity = TypeVar("Quantity", float, FloatArray)

TESLA_PER_FIELD_UNIT = {"nT": 1e-9, "uT": 1e-6, "mT": 1e-3, "mG": 1e-7, "G": 1e-4, "T": 1.0}


def to_nanotesla(tesla: Quantity) -> Quantity:
    """Convert tesla to nanotesla, and T/m to nT/m."""
    return tesla * 1e9


def from_nanotesla(nanotesla: Quantity) -> Quantity:
    """Convert nanotesla to tesla, and nT/m to T/m; a division, so that decimals round correctly."""
    return nanotesla / 1e9


def to_degrees(radians: Quantity) -> Quantity:
    """Convert radians to degrees."""
    return radians * (180.0 / np.pi)


def from_degrees(degrees: Quantity) -> Quantity:
    """Convert degrees to radians."""
    return degrees * (np.pi / 180.0)


_FOR_PEOPLE = {"T": (to_nanotesla(1.0), "nT"), "K": (1.0, "°C"), "rad": (to_degrees(1.0), "°")}
_SYMBOL = re.compile(r"([A-Za-z]+)([²³⁴⁵]?)")


def for_people(unit: str) -> tuple[float, str]:
    """Return the factor from an SI unit to that of files and reports, and its name: T/K is 1e9 nT/°C."""
    factor, written = 1.0, []
    if unit.startswith("1/") and "T" not in unit and ("K" in unit or "A" in unit):
        factor, unit = 1e6, f"ppm{unit[1:]}"
    for part, sign in zip(unit.split("/", 1), (1, -1), strict=False):
        for symbol, power in _SYMBOL.findall(part):
            factor *= _FOR_PEOPLE.get(symbol, (1.0, ""))[0] ** (sign * (" ²³⁴⁵".index(power) + 1 if power else 1))
        written.append(_SYMBOL.sub(lambda match: _FOR_PEOPLE.get(match[1], (1.0, match[1]))[1] + match[2], part))
    return factor, "/".join(written)
