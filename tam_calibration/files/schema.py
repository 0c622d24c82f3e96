"""Mappings of a file read into frozen dataclasses, whose annotations state keys, types, units and bounds."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import MISSING, astuple, dataclass, field, fields, is_dataclass
from datetime import UTC, date, datetime
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform, get_args, get_origin, get_type_hints

import numpy as np

from tam_calibration.model.data_sheet import ChangeRates, Gyroscope, Tolerances
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla

Schema = TypeVar("Schema")


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(field,))
class Document:
    """A mapping in a file: a subclass is a frozen dataclass with a field for each key."""

    def __init_subclass__(cls) -> None:
        """Make the subclass a dataclass."""
        dataclass(frozen=True, kw_only=True)(cls)


@dataclass(frozen=True)
class Bounds:
    """What a number must keep to, as in ``Annotated[float, Bounds(above=0)]``; it must be finite.

    Parameters
    ----------
    above : float
        The number is greater.
    least, most : float
        The number is not less, and not greater.
    unit : str
        Of the number, where a wrong one is what mostly breaks the bounds.
    may_be_nan : bool
        Whether it may be unknown: null or NaN in the file, NaN when read.
    """

    above: float = -math.inf
    least: float = -math.inf
    most: float = math.inf
    unit: str = ""
    may_be_nan: bool = False

    def broken_by(self, number: float) -> str:
        """Return what a number should be and is not; empty where it keeps to all."""
        if self.may_be_nan and math.isnan(number):
            return ""
        if not abs(number) < math.inf:
            return "a finite number"
        if number <= self.above:
            return f"greater than {self.above}"
        hint = f" {self.unit}, not {number:g}: check the unit" if self.unit else ""
        if number < self.least:
            return f"greater than or equal to {self.least}{hint}"
        return f"less than or equal to {self.most}{hint}" if number > self.most else ""


def check(content: Mapping[str, Any], schema: type[Schema]) -> Schema:
    """Return the content as an instance of its schema.

    A key that the schema has not is a fault, unless its class attribute ``may_hold_more`` is true: so are formats of
    others. Text is no number; dates are read from text. Of several dataclasses the one is taken whose ``kind`` the
    mapping states.

    Parameters
    ----------
    content : mapping of str
        Keys and values of a file.
    schema : type
        A dataclass with a field for each key that there may be; those without a default must be there.

    Raises
    ------
    InputError
        When it does not follow the schema; one sentence names the first fault.
    """
    checked: Schema = _document(schema, content, "")
    return checked


def check_file(content: Mapping[str, Any], kind: str, stated: str, schema: type[Schema]) -> Schema:
    """Return the content of a file of some kind, which must state the schema that this version reads.

    Raises
    ------
    InputError
        When it states another, or none, or does not fit it.
    """
    found = content.get("schema")
    if found != stated:
        told = "has no schema" if found is None else f"has the schema {quoted(found)}"
        raise InputError(f"this is no {kind} that this version reads: it {told}, not {stated!r}")
    return check(content, schema)


def _value(kind: Any, value: Any, place: str) -> Any:
    """Return a value as a type has it."""
    if kind is Any:
        return value
    if kind in _PLAIN:
        convert, name = _PLAIN[kind]
        try:
            return convert(value)
        except (ValueError, OverflowError):
            raise _fault(place, f"a valid {name}") from None
    read, needed, name = _DOCUMENT if is_dataclass(kind) else _COMPOSED[get_origin(kind)]
    if not isinstance(value, needed):
        raise _fault(place, name)
    return read(kind, value, place)


def _fault(place: str, right: str) -> InputError:
    return InputError(f"{place}: input should be {right}")


@cache
def _types(schema: Any) -> dict[str, Any]:
    return get_type_hints(schema, include_extras=True)


def _document(schema: Any, content: Any, place: str) -> Any:
    within = f"{place}." if place else ""
    values = {}
    for each in fields(schema):
        if each.name in content:
            values[each.name] = _value(_types(schema)[each.name], content[each.name], within + each.name)
        elif each.default is MISSING and each.default_factory is MISSING:
            raise InputError(f"the key {within + each.name!r} is missing")
    unknown = content.keys() - values.keys()
    if unknown and not getattr(schema, "may_hold_more", False):
        key = next(key for key in content if key in unknown)
        hint = "" if within else f"; known are {', '.join(each.name for each in fields(schema))}"
        raise InputError(f"the key '{within}{key}' is not known{hint}")
    return schema(**values)


def _list(kind: Any, value: Any, place: str) -> Any:
    (part,) = get_args(kind)
    return [_value(part, each, f"{place}.{number}") for number, each in enumerate(value, start=1)]


def _tuple(kind: Any, value: Any, place: str) -> Any:
    parts = get_args(kind)
    if len(value) > len(parts):
        raise InputError(f"{place}: tuple should have at most {len(parts)} items, not {len(value)}")
    if len(value) < len(parts):
        raise InputError(f"the key '{place}.{len(value) + 1}' is missing")
    pairs = enumerate(zip(parts, value, strict=True), start=1)
    return tuple(_value(part, each, f"{place}.{number}") for number, (part, each) in pairs)


def _dict(kind: Any, value: Any, place: str) -> Any:
    name, part = get_args(kind)
    return {_value(name, key, place): _value(part, value[key], f"{place}.{key}") for key in value}


def _literal(kind: Any, value: Any, place: str) -> Any:
    if value not in get_args(kind):
        raise _fault(place, " or ".join(repr(choice) for choice in get_args(kind) if choice != ""))
    return value


def _bounded(kind: Any, value: Any, place: str) -> Any:
    base, bounds = get_args(kind)
    if value is None and bounds.may_be_nan:
        return math.nan
    number = _value(base, value, place)
    if broken := bounds.broken_by(number):
        raise _fault(place, broken)
    return number


def _one_of(kind: Any, value: Any, place: str) -> Any:
    """Return a value as the first type of a union that has it."""
    kinds = [each for each in get_args(kind) if each is not NoneType]
    if value is None and NoneType in get_args(kind):
        return None
    if len(kinds) > 1 and all(is_dataclass(each) for each in kinds):
        return _of_kind(kinds, value, place)
    problems = []
    for each in kinds:
        try:
            return _value(each, value, place)
        except InputError as problem:
            problems.append(problem)
    # A list or a mapping was meant for what takes one.
    raise problems[-1] if isinstance(value, list | Mapping) else problems[0]


def _of_kind(schemas: list[Any], content: Any, place: str) -> Any:
    if not isinstance(content, Mapping):
        raise _fault(place, "a mapping of keys to values")
    if "kind" not in content:
        raise InputError(f"the key '{place}.kind' is missing")
    by_kind = {kind: schema for schema in schemas for kind in get_args(_types(schema)["kind"])}
    kind = content["kind"]
    if not isinstance(kind, str) or kind not in by_kind:
        raise InputError(f"{place}: the kind {quoted(kind)} is not one of {', '.join(by_kind)}")
    return _document(by_kind[kind], content, place)


def _exactly(value: Any, *kinds: type) -> Any:
    """Return a value that is of one of some types; a boolean is no number."""
    if not isinstance(value, kinds) or (isinstance(value, bool) and bool not in kinds):
        raise ValueError
    return value


def _integer(value: Any) -> int:
    number = _exactly(value, int, float)
    # No count or seed is larger, and no sentence quotes more digits.
    if not abs(number) <= 10**40 or number != int(number):
        raise ValueError
    return int(number)


def _moment(value: Any) -> datetime:
    moment = datetime.fromisoformat(_exactly(value, str))
    return moment if moment.tzinfo is None else moment.astimezone(UTC)


_PLAIN: dict[Any, tuple[Callable[[Any], Any], str]] = {
    float: (lambda value: float(_exactly(value, int, float)), "number"),
    int: (_integer, "integer"),
    bool: (lambda value: _exactly(value, bool), "boolean"),
    str: (lambda value: _exactly(value, str), "string"),
    date: (lambda value: date.fromisoformat(_exactly(value, str)), "date"),
    datetime: (_moment, "datetime"),
}
"""Types of single values: what makes one of a value or raises, and their names for people."""

_DOCUMENT = _document, Mapping, "a mapping of keys to values"

_COMPOSED: dict[Any, tuple[Callable[[Any, Any, str], Any], Any, str]] = {
    Annotated: (_bounded, object, ""),
    Literal: (_literal, object, ""),
    Union: (_one_of, object, ""),
    UnionType: (_one_of, object, ""),
    dict: (_dict, Mapping, "a mapping of keys to values"),
    list: (_list, list | tuple, "a valid list"),
    tuple: (_tuple, list | tuple, "a valid list"),
}
"""How values of composed types are read, what they must be for that, and the name of that for people."""


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
    return np.asarray(_from_si(np.asarray(value), unit) if unit else value).tolist()


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
    return _from_si(tesla, "nT")


def _from_si(values: FloatArray, unit: str) -> FloatArray:
    """Return values in a unit of keys that turn back into the same, if possible to the last bit."""
    to_si, from_si = _UNITS[unit]
    best: FloatArray = from_si(np.asarray(values, dtype=float))
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
