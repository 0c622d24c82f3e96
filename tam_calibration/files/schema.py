"""Mappings of a file read into frozen dataclasses, whose annotations state keys, types and bounds."""

import math
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from datetime import UTC, date, datetime
from functools import cache
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform, get_args, get_origin, get_type_hints

from tam_calibration.model.exceptions import InputError, quoted

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


def require_schema(content: Mapping[str, Any], kind: str, schema: str) -> None:
    """Check that a file of some kind states the schema that this version reads.

    Raises
    ------
    InputError
        When it states another, or none.
    """
    found = content.get("schema")
    if found != schema:
        stated = "has no schema" if found is None else f"has the schema {quoted(found)}"
        raise InputError(f"this is no {kind} that this version reads: it {stated}, not {schema!r}")


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
    faults: list[str] = []
    checked: Schema = _document(schema, content, "", faults)
    if faults:
        others = f" (and {len(faults) - 1} more faults)" if len(faults) > 1 else ""
        raise InputError(f"{faults[0]}{others}")
    return checked


def _value(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    """Return a value as a type has it; where it has no such value, add the fault and return None."""
    if kind is Any:
        return value
    if kind in _PLAIN:
        convert, name = _PLAIN[kind]
        try:
            return convert(value)
        except (ValueError, OverflowError):
            return _fault(f"a valid {name}", place, faults)
    read, needed, name = _DOCUMENT if is_dataclass(kind) else _COMPOSED[get_origin(kind)]
    return read(kind, value, place, faults) if isinstance(value, needed) else _fault(name, place, faults)


def _fault(right: str, place: str, faults: list[str]) -> None:
    faults.append(f"{place}: input should be {right}")


@cache
def _types(schema: Any) -> dict[str, Any]:
    return get_type_hints(schema, include_extras=True)


def _document(schema: Any, content: Any, place: str, faults: list[str]) -> Any:
    within = f"{place}." if place else ""
    values = {}
    for each in fields(schema):
        if each.name in content:
            values[each.name] = _value(_types(schema)[each.name], content[each.name], within + each.name, faults)
        elif each.default is MISSING and each.default_factory is MISSING:
            faults.append(f"the key {within + each.name!r} is missing")
    known = [each.name for each in fields(schema)]
    hint = "" if within else f"; known are {', '.join(known)}"
    if not getattr(schema, "may_hold_more", False):
        faults += [f"the key '{within}{key}' is not known{hint}" for key in content if key not in known]
    return None if faults else schema(**values)


def _list(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    (part,) = get_args(kind)
    return [_value(part, each, f"{place}.{number}", faults) for number, each in enumerate(value, start=1)]


def _tuple(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    parts = get_args(kind)
    if len(value) > len(parts):
        faults.append(f"{place}: tuple should have at most {len(parts)} items, not {len(value)}")
        return None
    faults += [f"the key '{place}.{number}' is missing" for number in range(len(value) + 1, len(parts) + 1)]
    pairs = enumerate(zip(parts, value, strict=False), start=1)
    return tuple(_value(part, each, f"{place}.{number}", faults) for number, (part, each) in pairs)


def _dict(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    name, part = get_args(kind)
    return {_value(name, key, place, faults): _value(part, value[key], f"{place}.{key}", faults) for key in value}


def _literal(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    choices = [repr(choice) for choice in get_args(kind) if choice != ""]
    return value if value in get_args(kind) else _fault(" or ".join(choices), place, faults)


def _bounded(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    base, bounds = get_args(kind)
    if value is None and bounds.may_be_nan:
        return math.nan
    number = _value(base, value, place, faults)
    broken = "" if number is None else bounds.broken_by(number)
    return _fault(broken, place, faults) if broken else number


def _one_of(kind: Any, value: Any, place: str, faults: list[str]) -> Any:
    """Return a value as the first type of a union that has it; otherwise raise the first error."""
    kinds = [each for each in get_args(kind) if each is not NoneType]
    if value is None and NoneType in get_args(kind):
        return None
    if len(kinds) > 1 and all(is_dataclass(each) for each in kinds):
        return _of_kind(kinds, value, place, faults)
    failed = []
    for each in kinds:
        own: list[str] = []
        read = _value(each, value, place, own)
        if not own:
            return read
        failed.append(own)
    # A list or a mapping was meant for what takes one.
    faults += failed[-1] if isinstance(value, list | Mapping) else failed[0]
    return None


def _of_kind(schemas: list[Any], content: Any, place: str, faults: list[str]) -> Any:
    if not isinstance(content, Mapping):
        return _fault("a mapping of keys to values", place, faults)
    if "kind" not in content:
        faults.append(f"the key '{place}.kind' is missing")
        return None
    by_kind = {kind: schema for schema in schemas for kind in get_args(_types(schema)["kind"])}
    kind = content["kind"]
    if not isinstance(kind, str) or kind not in by_kind:
        faults.append(f"{place}: the kind {quoted(kind)} is not one of {', '.join(by_kind)}")
        return None
    return _document(by_kind[kind], content, place, faults)


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

_COMPOSED: dict[Any, tuple[Callable[[Any, Any, str, list[str]], Any], Any, str]] = {
    Annotated: (_bounded, object, ""),
    Literal: (_literal, object, ""),
    Union: (_one_of, object, ""),
    UnionType: (_one_of, object, ""),
    dict: (_dict, Mapping, "a mapping of keys to values"),
    list: (_list, list | tuple, "a valid list"),
    tuple: (_tuple, list | tuple, "a valid list"),
}
"""How values of composed types are read, what they must be for that, and the name of that for people."""
