"""Effects with numbers, as scenario and calibration files state them.

    effects:
      - effect: temperature_drift
        shape: {time_constant_s: 20, reference_C: 20}
        terms:
          - {sensor: 2, axis: x, term: offset, values: {offset: 12 nT/K}}

A value is text with a unit, in which nT, uT and deg may stand for T and rad, or a plain number in SI.
"""

import re
from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.files.schema import Bounds, Document, value_in_si, value_to_write
from tam_calibration.messages.missing import HUGE
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect

_AXES = "xyz"
_SPECIAL = {"scalar": SCALAR, "all": ALL}
_PLAIN_UNITS = frozenset({"1", "T", "rad", "s", "Hz", "K", "°C", "A", "m"})
_WRITTEN = {"T": "nT", "rad": "deg"}
"""Units of SI, and what is written for them at the beginning of a unit."""

_Quantity = Annotated[float, Bounds()] | str


class TermFile(Document):
    """What an effect does to one sensor or axis."""

    sensor: Annotated[int, Bounds(least=1)] | Literal["scalar", "all"]
    axis: Literal["x", "y", "z"] | None = None
    term: str
    values: dict[str, _Quantity]
    standard_errors: dict[str, _Quantity] = field(default_factory=dict)

    def to_contribution(self) -> Contribution:
        """Return it in SI."""
        sensor = _SPECIAL[self.sensor] if isinstance(self.sensor, str) else self.sensor - 1
        axis = None if self.axis is None else _AXES.index(self.axis)
        return Contribution(sensor, axis, self.term, _in_si(self.values), _in_si(self.standard_errors, 0.0))


class EffectFile(Document):
    """One effect."""

    effect: str
    shape: dict[str, _Quantity] = field(default_factory=dict)
    shape_standard_errors: dict[str, _Quantity] = field(default_factory=dict)
    terms: list[TermFile]

    def to_fitted(self) -> FittedEffect:
        """Return it in SI.

        Raises
        ------
        InputError
            When a value is no number with a unit.
        """
        terms = tuple(term.to_contribution() for term in self.terms)
        return FittedEffect(self.effect, _in_si(self.shape), terms, _in_si(self.shape_standard_errors, 0.0))


def effect_to_mapping(fitted: FittedEffect, units: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Return an effect as files hold it: read again, its numbers are the same to the last bit.

    Parameters
    ----------
    fitted : FittedEffect
        In SI.
    units : mapping, optional
        SI units of coefficients and parameters of the shape, by name; what is not in it is written as a plain number.
    """
    known = units or {}
    mapping: dict[str, Any] = {"effect": fitted.effect}
    for key, values in (("shape", fitted.shape), ("shape_standard_errors", fitted.shape_errors)):
        if values:
            mapping[key] = _to_write(values, known)
    mapping["terms"] = [_term_to_mapping(part, known) for part in fitted.contributions]
    return mapping


def _term_to_mapping(part: Contribution, units: Mapping[str, str]) -> dict[str, Any]:
    names = {index: name for name, index in _SPECIAL.items()}
    mapping: dict[str, Any] = {"sensor": names.get(part.sensor, part.sensor + 1)}
    if part.axis is not None:
        mapping["axis"] = _AXES[part.axis]
    mapping |= {"term": part.term, "values": _to_write(part.values, units)}
    if part.standard_errors:
        mapping["standard_errors"] = _to_write(part.standard_errors, units)
    return mapping


def _to_write(values: Mapping[str, float], units: Mapping[str, str]) -> dict[str, _Quantity]:
    return {name: _quantity(float(value), units.get(name)) for name, value in values.items()}


def _quantity(value: float, unit: str | None) -> _Quantity:
    """Return text with a unit for people; the number itself where the unit is not known, or there is none."""
    if unit is None or unit == "1":
        return value
    first, slash, rest = unit.partition("/")
    if first in _WRITTEN and not _powers(rest) & _WRITTEN.keys():
        first = _WRITTEN[first]
        value = value_to_write(first, value)
    return f"{value!r} {first}{slash}{rest}"


def _in_si(values: Mapping[str, _Quantity], least: float = -HUGE) -> dict[str, float]:
    numbers = {name: _number(name, value) for name, value in values.items()}
    for name, number in numbers.items():
        if number < least:
            raise InputError(f"{name}: {quoted(values[name])} is less than {least:g} in SI")
        if abs(number) > HUGE:
            raise InputError(f"{name}: {quoted(values[name])} is more than {HUGE:g} in SI: check the unit")
    return numbers


def _number(name: str, value: _Quantity) -> float:
    if not isinstance(value, str):
        return float(value)
    number, _, unit = value.strip().partition(" ")
    try:
        plain = float(number)
    except ValueError:
        plain = np.nan
    if not np.isfinite(plain):
        raise InputError(f"{name}: {quoted(value)} is no number with a unit such as '12 nT/K'")
    first, _, rest = (unit.strip() or "1").partition("/")
    unknown = (_powers(first) - {"nT", "uT", "µT", "deg"} | _powers(rest)) - _PLAIN_UNITS
    if unknown:
        raise InputError(f"{name}: the unit {quoted(unit)} is not known: write T, nT, uT, rad, deg, s, Hz, K, A and m")
    if first in ("uT", "µT"):
        first, plain = "nT", plain * 1e3
    return float(value_in_si(first, plain))


def _powers(product: str) -> set[str]:
    """Return the units of a product, without their exponents: {"T", "K"} for "T K²"."""
    return {re.sub(r"[²³⁴⁵]|\^\d+$", "", token) for token in product.replace("·", " ").replace("/", " ").split()}
