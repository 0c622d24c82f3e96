"""Conversion between SI units and those of files and reports: the only place that converts."""

from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.floating[Any]]
Quantity = TypeVar("Quantity", float, FloatArray)

NANOTESLA_PER_TESLA = 1e9
TESLA_PER_FIELD_UNIT = {"nT": 1e-9, "uT": 1e-6, "G": 1e-4, "T": 1.0}


def to_nanotesla(tesla: Quantity) -> Quantity:
    """Convert tesla to nanotesla, and T/m to nT/m."""
    return tesla * NANOTESLA_PER_TESLA


def from_nanotesla(nanotesla: Quantity) -> Quantity:
    """Convert nanotesla to tesla, and nT/m to T/m; a division, so that decimals round correctly."""
    return nanotesla / NANOTESLA_PER_TESLA


def to_degrees(radians: Quantity) -> Quantity:
    """Convert radians to degrees."""
    return radians * (180.0 / np.pi)


def from_degrees(degrees: Quantity) -> Quantity:
    """Convert degrees to radians."""
    return degrees * (np.pi / 180.0)
