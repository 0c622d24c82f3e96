"""Conversion between SI and the units and times of files and reports: the only place that converts."""

import re
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
IntArray = NDArray[np.integer[Any]]
Quantity = TypeVar("Quantity", float, FloatArray)

TESLA_PER_FIELD_UNIT = {"nT": 1e-9, "uT": 1e-6, "mT": 1e-3, "mG": 1e-7, "G": 1e-4, "T": 1.0}
"""Units of the field that files may have, as they are written; 1 G is 100 µT by definition."""


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


def rounded(value: float, digits: int = 2) -> str:
    """Format with some significant digits, and without an exponent up to a million: 220, 9.9, 0.013."""
    return f"{float(f'{value:.{digits}g}'):g}"


_FOR_PEOPLE = {"T": (to_nanotesla(1.0), "nT"), "K": (1.0, "°C"), "rad": (to_degrees(1.0), "°")}
"""By SI unit: the factor to the unit of files and reports, and its name."""

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


class ErrorKind(NamedTuple):
    """Three errors of a sensor, in the units of files and reports.

    Parameters
    ----------
    name : str
        For people.
    unit, sign : str
        Unit in keys and for people.
    factor : float
        From SI.
    decimals : int
        Decimals to show.
    axes, columns : tuple of str
        Names of the three, for people and in the columns of tables.
    """

    name: str
    unit: str
    sign: str
    factor: float
    decimals: int
    axes: tuple[str, ...] = ("x", "y", "z")
    columns: tuple[str, ...] = ("x", "y", "z")

    def key(self, part: str = "") -> str:
        """Return the key of the values in files, or of a part such as "standard_error"."""
        return "_".join(filter(None, (self.name.replace(" ", "_").replace("-", "_"), part, self.unit)))

    @property
    def of_changes(self) -> "ErrorKind":
        """The kind as changes are told: of what has no unit in ppm."""
        return self if self.sign else self._replace(factor=1e6, sign="ppm")


ERROR_KINDS = (
    ErrorKind("scale factor", "", "", 1.0, 6),
    ErrorKind("non-orthogonality", "deg", "°", to_degrees(1.0), 5, ("θ", "φ", "ψ"), ("theta", "phi", "psi")),
    ErrorKind("bias", "nT", "nT", to_nanotesla(1.0), 2),
    ErrorKind("misalignment", "deg", "°", to_degrees(1.0), 5, ("α", "β", "γ"), ("alpha", "beta", "gamma")),
)
"""The errors of a sensor in the order of their vector."""


def has_date(time_s: float) -> bool:
    """Whether a stamp counts from 1970; smaller ones, up to three years, count from the start of a recording."""
    return time_s > 1e8


def origin_of(start_s: float) -> float:
    """Return the stamp from which sentences count seconds: the first of a recording with dates, else zero."""
    return start_s if has_date(start_s) else 0.0
