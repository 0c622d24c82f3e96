"""The quantities of our files: what a number can be in the unit of its key; beyond, it is of another unit or damage."""

from dataclasses import fields
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.files.schema import Bounds
from tam_calibration.model.units import from_degrees, from_nanotesla

Finite = Annotated[float, Bounds()]
Vector = tuple[Finite, Finite, Finite]
Tensor = tuple[Vector, Vector, Vector]

ScaleFactor = Annotated[float, Bounds(least=1e-4, most=1e4, unit="nT per nT")]
"""Gauss that are taken for nanotesla, the largest mistake that a fit can make, give 1e-5; µT give 1e-3."""
ScaleFactors = tuple[ScaleFactor, ScaleFactor, ScaleFactor]

Nanotesla = Annotated[float, Bounds(least=-1e9, most=1e9, unit="nT")]
"""Of a field, a bias, or a field per metre: one tesla, which only magnets in a laboratory make."""
NanoteslaVector = tuple[Nanotesla, Nanotesla, Nanotesla]
NanoteslaTensor = tuple[NanoteslaVector, NanoteslaVector, NanoteslaVector]

NanoteslaSize = Annotated[float, Bounds(least=0, most=1e12, unit="nT", may_be_nan=True)]
"""Of a residual or a standard error, or of it per metre; NaN where the array does not determine it."""

Degrees = Annotated[float, Bounds(least=-360, most=360, unit="deg")]
"""Of a turn."""
Turns = tuple[Degrees, Degrees, Degrees]

Shear = Annotated[float, Bounds(least=-85, most=85, unit="deg")]
"""Of an axis from its right angle: at 90 degrees it is another one, and the matrix of the sensor has no inverse."""
Shears = tuple[Shear, Shear, Shear]

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]
Orientation = tuple[Axis, Axis, Axis]
"""Of a sensor: which axis of the array each of its axes points along."""

NOT_TURNED: Orientation = ("x", "y", "z")

Metres = Annotated[float, Bounds(least=-1e6, most=1e6, unit="m")]
"""From the array to a source: a thousand kilometres."""
Place = tuple[Metres, Metres, Metres]

AmpereSquareMetres = Annotated[float, Bounds(least=-1e12, most=1e12, unit="Am²")]
"""Of a moment: a large ship has 1e6 Am²."""
Moment = tuple[AmpereSquareMetres, AmpereSquareMetres, AmpereSquareMetres]

Seconds = Annotated[float, Bounds(least=-9.2e9, most=9.2e9, unit="s")]
"""Since 1970, in 64 bits of nanoseconds."""

Period = Annotated[float, Bounds(above=0, least=1e-6, most=1e9, unit="s")]
"""From a megahertz to thirty years."""

Hertz = Annotated[float, Bounds(above=0, least=1e-9, most=1e6, unit="Hz")]
"""Of samples or of a field: the same."""

Celsius = Annotated[float, Bounds(least=-273.15, most=1e4, unit="°C")]
"""From the absolute zero to where all is gas."""

Ampere = Annotated[float, Bounds(least=-1e6, most=1e6, unit="A")]
"""Of a current on the vehicle."""


def in_si(block: Any) -> list[Any]:
    """Return the values of a checked block in SI, in the order of its keys, which name the units; lists become arrays.

    Parameters
    ----------
    block : dataclass
        Keys with nT are fields, or fields per metre, those with deg angles; others have SI units, or none.
    """
    values = [(field.name, getattr(block, field.name)) for field in fields(block)]
    return [None if value is None else value_in_si(key, value) for key, value in values]


def value_in_si(key: str, value: Any) -> Any:
    """Return the value of a key in SI; a list becomes an array."""
    number = np.array(value) if isinstance(value, list | tuple) else value
    return from_nanotesla(number) if "_nT" in key else from_degrees(number) if "_deg" in key else number
