"""Effects with numbers, as scenario and calibration files state them.

    effects:
      - effect: temperature_drift
        shape: {time_constant_s: 20, reference_C: 20}
        terms:
          - {sensor: 2, axis: x, term: offset, values: {offset: 12 nT/K}}

A value is text with the unit of the effect, in which nT, uT and deg may stand for T and rad, or a plain number in SI.
"""

import re
from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, Literal

import numpy as np

from tam_calibration.effects.library import check_numbers, installed_effects, units_of
from tam_calibration.files.schema import Bounds, Document, value_in_si, value_to_write
from tam_calibration.messages.missing import HUGE
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.sensor_errors import SensorErrors

_AXES = "xyz"
_SPECIAL = {"scalar": SCALAR, "all": ALL}
_WRITTEN = {"T": "nT", "rad": "deg"}
"""Units of SI, and what is written for them at the beginning of a unit."""
_SI = {"nT": "T", "uT": "T", "µT": "T", "deg": "rad"}
"""Units that may be written in the place of those of SI."""

_Quantity = Annotated[float, Bounds()] | str


class TermFile(Document):
    """What an effect does to one sensor or axis."""

    sensor: Annotated[int, Bounds(least=1)] | Literal["scalar", "all"]
    axis: Literal["x", "y", "z"] | None = None
    term: str
    values: dict[str, _Quantity]
    standard_errors: dict[str, _Quantity] = field(default_factory=dict)

    def to_contribution(self, units: Mapping[str, str]) -> Contribution:
        """Return it in SI; the unit of a value that has none in the mapping is not checked."""
        sensor = _SPECIAL[self.sensor] if isinstance(self.sensor, str) else self.sensor - 1
        axis = None if self.axis is None else _AXES.index(self.axis)
        return Contribution(
            sensor, axis, self.term, _in_si(self.values, units), _in_si(self.standard_errors, units, 0.0)
        )


class EffectFile(Document):
    """One effect."""

    effect: str
    shape: dict[str, _Quantity] = field(default_factory=dict)
    shape_standard_errors: dict[str, _Quantity] = field(default_factory=dict)
    terms: list[TermFile]

    def to_fitted(self, errors: SensorErrors, array: Array) -> FittedEffect:
        """Return it in SI.

        Parameters
        ----------
        errors : SensorErrors
            Of the sensors that it acts on.
        array : Array
            Positions of the sensors and of the scalar magnetometer.

        Raises
        ------
        InputError
            When there is no such effect, term or value, or a value is no number with its unit.
        """
        effect = installed_effects().get(self.effect)
        if effect is None:
            raise InputError(f"there is no effect {quoted(self.effect)} here: install its package, or correct its name")
        units: Mapping[str, str] = getattr(effect, "shape_units", {})
        shape, shape_errors = _in_si(self.shape, units), _in_si(self.shape_standard_errors, units, 0.0)
        # Only an effect with its shape and terms tells the units of their values.
        fitted = FittedEffect(self.effect, shape, tuple(term.to_contribution({}) for term in self.terms), shape_errors)
        check_numbers(fitted, errors, array)
        units = units_of(fitted, errors, array)
        return replace(fitted, contributions=tuple(term.to_contribution(units) for term in self.terms))


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
    written = _to_people(unit)
    return f"{value_to_write(re.split(r'[^a-zA-Z]', written)[0], value)!r} {written}"


def _to_people(unit: str) -> str:
    """Return a unit of SI as files write it, with nT for a T at its beginning, and deg for rad."""
    return re.sub(r"^(T|rad)(?![\w^])", lambda match: _WRITTEN[match[1]], unit)


def _symbols(unit: str) -> tuple[list[str], list[str]]:
    """Return the symbols above and below the line of a unit, sorted: ["T", "s²"] and ["K"] of "T·s^2/°C"."""
    plain = re.sub(r"\^(\d)", lambda match: "⁰¹²³⁴⁵⁶⁷⁸⁹"[int(match[1])], unit)
    above, _, below = plain.translate(dict.fromkeys(map(ord, "·*()"), " ")).partition("/")
    return sorted(above.split()) or ["1"], sorted(below.replace("°C", "K").split())


def _in_si(values: Mapping[str, _Quantity], units: Mapping[str, str], least: float = -HUGE) -> dict[str, float]:
    numbers = {name: _number(name, value, units.get(name)) for name, value in values.items()}
    for name, number in numbers.items():
        if not least <= number <= HUGE:
            bound = f"less than {least:g}" if number < least else f"more than {HUGE:g}"
            raise InputError(f"{name}: {quoted(values[name])} is {bound} in SI: check the unit")
    return numbers


def _number(name: str, value: _Quantity, unit: str | None) -> float:
    """Return a value in SI, which must be stated in its unit where that is known, or without any."""
    if not isinstance(value, str):
        return float(value)
    number, _, written = value.strip().partition(" ")
    try:
        plain = float(number)
    except ValueError:
        plain = np.nan
    if not np.isfinite(plain):
        raise InputError(f"{name}: {quoted(value)} is no number with a unit such as '12 nT/K'")
    above, below = _symbols(written)
    if unit is not None and written and (sorted(_SI.get(each, each) for each in above), below) != _symbols(unit):
        asked = "no unit" if unit == "1" else f"the unit {_to_people(unit)}"
        raise InputError(f"{name}: {quoted(value)} must have {asked}")
    for symbol in above:
        key, plain = ("nT", 1e3 * plain) if symbol in ("uT", "µT") else (symbol, plain)
        plain = float(value_in_si(key, plain))
    return plain
