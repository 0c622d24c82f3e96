"""The quantities of our files, each with its unit and bounds, and blocks of them that several files have."""

from collections.abc import Callable, Iterable
from dataclasses import astuple, fields
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.files.schema import Bounds, Document
from tam_calibration.model.data_sheet import ChangeRates, Gyroscope, Tolerances
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla

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


_UNITS: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any]]] = {
    "nT": (from_nanotesla, to_nanotesla),
    "deg": (from_degrees, to_degrees),
    "mdps": (lambda number: from_degrees(number) / 1000, lambda number: to_degrees(1000 * number)),
    "percent": (lambda number: number / 100, lambda number: number * 100),
    "ppm": (lambda number: number / 1e6, lambda number: number * 1e6),
}
"""Units in keys that are not SI: conversion to SI, and from it."""


def _unit_in(key: str) -> str:
    return next((part for part in key.split("_") if part in _UNITS), "")


def in_si(block: Any) -> list[Any]:
    """Return the values of a checked block in SI, in the order of its keys, which name the units; lists become arrays.

    Parameters
    ----------
    block : dataclass
        Keys with nT are fields, or fields per metre, those with deg angles; others have SI units, or none.
    """
    return [value_in_si(field.name, getattr(block, field.name)) for field in fields(block)]


def value_in_si(key: str, value: Any) -> Any:
    """Return the value of a key in SI; a list becomes an array, and what is no number stays as it is."""
    if value is None or isinstance(value, str):
        return value
    number = np.array(value) if isinstance(value, list | tuple) else value
    return _UNITS[unit][0](number) if (unit := _unit_in(key)) else number


def value_to_write(key: str, value: Any) -> Any:
    """Return a value in SI in the unit of its key; `value_in_si` turns it back, if possible to the last bit.

    Arrays become lists; what is no number stays as it is.
    """
    if not isinstance(value, int | float | np.ndarray | np.generic):
        return value
    unit = _unit_in(key)
    return np.asarray(_inverse(np.asarray(value), *_UNITS[unit]) if unit else value).tolist()


def block_to_write(schema: type[Any], values: Iterable[Any]) -> dict[str, Any]:
    """Return keys and values of a block of a file, without those that are None.

    Parameters
    ----------
    schema : type
        Dataclass of the block.
    values : iterable
        In SI, in the order of its keys; the first ones are enough.
    """
    pairs = zip((field.name for field in fields(schema)), values, strict=False)
    return {key: value_to_write(key, value) for key, value in pairs if value is not None}


def nanotesla_to_write(tesla: FloatArray) -> FloatArray:
    """Return nanotesla that `units.from_nanotesla` turns back into the same tesla, if possible to the last bit."""
    return _inverse(tesla, *_UNITS["nT"])


def _inverse(
    values: FloatArray, to_si: Callable[[FloatArray], FloatArray], from_si: Callable[[FloatArray], FloatArray]
) -> FloatArray:
    best = from_si(np.asarray(values, dtype=float))
    for candidate in (np.nextafter(best, -np.inf), np.nextafter(best, np.inf)):
        is_better = (to_si(best) != values) & (to_si(candidate) == values)
        best = np.where(is_better, candidate, best)
    return best


_Rate = Annotated[float, Bounds(least=0)]


class TolerancesFile(Document):
    """The keys of ``tolerances``; all of them are needed."""

    scale_factor_percent: float
    non_orthogonality_deg: float
    bias_nT: float
    misalignment_deg: float


class GyroscopeFile(Document):
    """The keys of ``gyroscope``; noise that is left out is estimated, and a bias that is left out is that of a chip.

    Parameters
    ----------
    noise_mdps_per_sqrt_Hz : float, optional
        One-sided density of the noise, as data sheets state it.
    bias_deg_per_s : float, optional
        Standard deviation of a constant bias of each axis about zero.
    scale_error_percent : float
        Standard deviation of the scale of each axis, and of the angles between axes; 0 by default.
    """

    noise_mdps_per_sqrt_Hz: float | None = None
    bias_deg_per_s: float | None = None
    scale_error_percent: float = 0.0


class RatesFile(Document):
    """The keys of ``change_rates``, in the order of `ChangeRates`; a rate that is not stated is the default there."""

    scale_factor_ppm_per_day: _Rate | None = None
    scale_factor_ppm_per_K: _Rate | None = None
    non_orthogonality_deg_per_day: _Rate | None = None
    non_orthogonality_deg_per_K: _Rate | None = None
    bias_nT_per_day: _Rate | None = None
    bias_nT_per_K: _Rate | None = None
    misalignment_deg_per_day: _Rate | None = None
    misalignment_deg_per_K: _Rate | None = None


Part = Tolerances | Gyroscope | ChangeRates
"""What data sheets tell, as a block of an array file."""

_SCHEMAS: dict[type, type[Document]] = {Tolerances: TolerancesFile, Gyroscope: GyroscopeFile, ChangeRates: RatesFile}
_PARTS = {schema: part for part, schema in _SCHEMAS.items()}


def part_of(block: Document | None) -> Any:
    """Return the part of an array that a block states, in SI, defaults where it states nothing; None of no block.

    Raises
    ------
    InputError
        When a value is beyond what a working sensor has.
    """
    if block is None:
        return None
    part = _PARTS[type(block)]
    stated = zip(fields(part), in_si(block), strict=True)
    return part(**{each.name: value for each, value in stated if value is not None})


def part_to_mapping(part: Part | None) -> dict[str, Any] | None:
    """Return keys and values of a part of an array file; None of no part."""
    return None if part is None else block_to_write(_SCHEMAS[type(part)], astuple(part))
