"""A diagnosis as JSON, the gap file, with the unit in the key."""

import math
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.correction.parts import Provenance
from tam_calibration.effects.effect import Sized
from tam_calibration.files.text_files import to_json, write_text
from tam_calibration.gap.checks import Check, Checks
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Cause, Considered, Gap, Size
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.units import for_people, to_nanotesla

_SCHEMA = "tam_calibration/gap/1"


def write_gap(path: Path, gap: Gap, source: Provenance | None = None) -> None:
    """Write a gap file.

    Parameters
    ----------
    path : Path
        The file.
    gap : Gap
        The diagnosis.
    source : Provenance, optional
        The recording that it is of.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    write_text(path, to_json(gap_to_mapping(gap, source)))


def gap_to_mapping(gap: Gap, source: Provenance | None = None) -> dict[str, Any]:
    """Return the content of a gap file.

    Parameters
    ----------
    gap : Gap
        The diagnosis.
    source : Provenance, optional
        The recording that it is of.
    """
    return {
        "schema": _SCHEMA,
        **attributes(gap, "verdict", "statement", "remarks"),
        "signature": [law_to_mapping(one) for one in gap.signature],
        "gap": sizes(gap.size) | rounded({"floor_nT": to_nanotesla(gap.size.floor_T)}),
        "noise": [_noise(one) for one in gap.noise] or None,
        "where": rounded(attributes(gap.where, "sensors", "axes", "time_s", "frequency_hz", "evidence")),
        "causes": [_cause(cause) for cause in gap.causes],
        "considered": [_considered(considered) for considered in gap.considered],
        **rounded(attributes(gap, "probabilities", "set_95", "smallest_gap", "most_unseen_errors")),
        "checks": None if gap.checks is None else _checks(gap.checks),
        "remainder": gap.remainder,
        "remaining": [law_to_mapping(one) for one in gap.remaining],
        "next_recording": gap.next_recording,
        "recording": source_to_mapping(source),
    }


def law_to_mapping(one: Signature) -> dict[str, Any]:
    """Return one law of a gap; sizes of its course in nT, or in per cent of the field for a gain."""
    names = "law", "course", "sensors", "axes", "energy", "times_s", "follows", "places"
    law = {name.replace("times", "time"): value for name, value in rounded(attributes(one, *names)).items()}
    if one.curve is None:
        return {**law, "curve": None}
    unit, factor = ("percent", 100.0) if one.curve.unit == "1" else ("nT", to_nanotesla(1.0))
    sizes = {"size": factor * one.curve.size, "standard_error": factor * one.curve.error}
    return {**law, "curve": {**rounded({"time_s": one.curve.time_s, **sizes}), "unit": unit}}


def source_to_mapping(source: Provenance | None) -> dict[str, Any] | None:
    """Return the file that a result is of: its name, size and digest; None where it is of none."""
    return None if source is None else attributes(source, "name", "size_bytes", "sha256")


def numbers_of(fitted: FittedEffect, units: Mapping[str, str]) -> dict[str, dict[str, Any]]:
    """Return value, standard error and unit of each parameter of an effect, by a name that is unique.

    Names are such as "time constant" of the shape, and "sensor 2 x offset" of a coefficient, with the name of its
    term where it would not be unique otherwise; a standard error that is not known is NaN.

    Parameters
    ----------
    fitted : FittedEffect
        Shape and coefficients, SI.
    units : mapping of str to str
        SI unit of each parameter of the shape and each coefficient, by name; what is returned has the unit of files,
        such as nT for T.
    """
    parameters = {
        _without_unit(name, units[name]): _parameter(value, fitted.shape_errors.get(name, math.nan), units[name])
        for name, value in fitted.shape.items()
    }
    entries = [(part, coefficient) for part in fitted.contributions for coefficient in part.values]
    uses = Counter([*parameters, *(_name(part, coefficient) for part, coefficient in entries)])
    for part, coefficient in entries:
        name = _name(part, coefficient)
        if uses[name] > 1:
            name = _name(part, f"{part.term} {coefficient}")
        error = part.standard_errors.get(coefficient, math.nan)
        parameters[name] = _parameter(part.values[coefficient], error, units[coefficient])
    return parameters


def _without_unit(name: str, unit: str) -> str:
    """Return "time constant" for time_constant_s: the value has its own unit, which may differ."""
    stem, _, last = name.rpartition("_")
    return (stem if last.lower() == unit.strip("°").lower() else name).replace("_", " ")


def _name(part: Contribution, what: str) -> str:
    sensor = {SCALAR: "scalar", ALL: "all sensors"}.get(part.sensor, f"sensor {part.sensor + 1}")
    axis = "" if part.axis is None else f" {'xyz'[part.axis]}"
    return f"{sensor}{axis} {what}"


def _parameter(value: float, standard_error: float, unit: str) -> dict[str, Any]:
    factor, name = for_people(unit)
    return {**rounded({"value": factor * value, "standard_error": factor * standard_error}), "unit": name}


def sizes(gap: Size) -> dict[str, Any]:
    """Return what a gap was and what is left of it: in noise floors, nT and nT/m, and the part that closes."""
    in_tesla = attributes(gap, "before_T", "after_T", "before_T_per_m", "after_T_per_m")
    in_nanotesla = {name.replace("_T", "_nT"): to_nanotesla(value) for name, value in in_tesla.items()}
    return rounded(attributes(gap, "before", "after", "closed", "closed_interval") | in_nanotesla)


def _noise(noise: AxisNoise) -> dict[str, Any]:
    """Return the noise of a row: its level with standard error, its white part and colour, and as stated."""
    names = ("level_nT", "standard_error_nT", "white_nT", "stated_nT")
    levels = to_nanotesla(np.array([noise.level_T, noise.level_error_T, noise.white_T, noise.stated_T]))
    sized = rounded(dict(zip(names, levels, strict=True)))
    return {**place_of(noise), **sized, "colour": noise.colour}


def place_of(noise: AxisNoise) -> dict[str, Any]:
    """Return the sensor and the axis of a row of noise."""
    return {"sensor": noise.sensor or "scalar", "axis": noise.axis or None}


def _checks(checks: Checks) -> dict[str, Any]:
    """Return what departs from the twin, and each statistic of each row with its range in the twin."""
    last = len(checks.line_hz) - 1
    rows = [
        {
            "sensor": "scalar" if row == last else row // 3 + 1,
            "axis": None if row == last else "xyz"[row % 3],
            **{name: _check(check, row) for name, check in checks.by_name.items()},
            **rounded({"line_Hz": checks.line_hz[row], "autocorrelation": checks.autocorrelation[row]}),
        }
        for row in range(last + 1)
    ]
    return {"departs": list(checks.sentences), "rows": rows}


def _check(check: Check, row: int) -> dict[str, Any]:
    return rounded({"value": check.values[row], "twin": [check.low[row], check.high[row]]})


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "effect": cause.fitted.effect,
        **rounded(attributes(cause, "sensors", "axes", "probability", "share")),
        "parameters": numbers_of(cause.fitted, cause.units),
        "evidence": rounded(attributes(cause, "delta_bic", "r2_cv")),
        "indistinguishable_from": list(cause.indistinguishable_from),
        "sizes": [_sized(sized) for sized in cause.sizes],
    }


def _sized(sized: Sized) -> dict[str, Any]:
    """Return a size with the largest known in nature, and its source."""
    factor, unit = for_people(sized.limit.unit)
    values = rounded({"value": factor * abs(sized.value), "largest_known": factor * sized.limit.largest})
    return {"name": sized.name, **values, "unit": unit, "source": sized.limit.source}


def _considered(considered: Considered) -> dict[str, Any]:
    tried = attributes(considered, "delta_bic", "r2_cv")
    evidence = rounded({name: value for name, value in tried.items() if value is not None})
    return {**attributes(considered, "effect", "status", "why"), "evidence": evidence}


def attributes(source: object, *names: str) -> dict[str, Any]:
    """Return some attributes by their names; arrays and tuples as lists."""
    return {name: _plain(getattr(source, name)) for name in names}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return list(map(_plain, value)) if isinstance(value, list | tuple) else value


def rounded(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by name, their numbers without the noise of conversions; what is no number as it is."""
    return {name: _round(_plain(value)) for name, value in values.items()}


def _round(value: Any) -> Any:
    """Return numbers to as many digits that a time since 1970 keeps its milliseconds."""
    if isinstance(value, Mapping):
        return rounded(value)
    if isinstance(value, list):
        return list(map(_round, value))
    return float(f"{value:.14g}") if isinstance(value, float) else value
