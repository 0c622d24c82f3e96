"""Results as JSON, with the unit in the key: the gap file of a diagnosis, and a survey."""

import math
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.comparison.result import Closing
from tam_calibration.correction.calibration import Provenance
from tam_calibration.effects.effect import Sized
from tam_calibration.files.text_files import to_json, write_text
from tam_calibration.gap.checks import Check, Checks
from tam_calibration.gap.laws.law import Signature
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Cause, Considered, Gap, Size, Where
from tam_calibration.localization.solutions import Status
from tam_calibration.localization.survey import Overall, Survey, standard_errors
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.units import for_people, to_nanotesla

_SCHEMA = "tam_calibration/gap/1"

_DIGITS = 14


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
        "verdict": gap.verdict,
        "statement": gap.statement,
        "remarks": list(gap.remarks),
        "signature": [law_to_mapping(one) for one in gap.signature],
        "gap": _size(gap.size),
        "noise": [_noise(one) for one in gap.noise] or None,
        "where": _where(gap.where),
        "causes": [_cause(cause) for cause in gap.causes],
        "considered": [_considered(considered) for considered in gap.considered],
        "probabilities": rounded(gap.probabilities),
        "set_95": list(gap.set_95),
        "smallest_gap": _round(gap.smallest_gap),
        "most_unseen_errors": _round(gap.most_unseen_errors),
        "checks": None if gap.checks is None else _checks(gap.checks),
        "remainder": gap.remainder,
        "remaining": [law_to_mapping(one) for one in gap.remaining],
        "next_recording": gap.next_recording,
        "recording": source_to_mapping(source),
    }


def law_to_mapping(one: Signature) -> dict[str, Any]:
    """Return one law of a gap; sizes of its course in nT, or in per cent of the field for a gain."""
    curve = None
    if one.curve is not None:
        unit, factor = ("percent", 100.0) if one.curve.unit == "1" else ("nT", to_nanotesla(1.0))
        curve = {
            "time_s": _list(one.curve.time_s),
            "size": _list(factor * one.curve.size),
            "standard_error": _list(factor * one.curve.error),
            "unit": unit,
        }
    return {
        "law": one.law,
        "course": one.course,
        "sensors": list(one.sensors),
        "axes": list(one.axes),
        "energy": _round(one.energy),
        "time_s": _list(one.times_s),
        "follows": one.follows,
        "places": [list(place) for place in one.places],
        "curve": curve,
    }


def source_to_mapping(source: Provenance | None) -> dict[str, Any] | None:
    """Return the file that a result is of: its name, size and digest; None where it is of none."""
    if source is None:
        return None
    return {"name": source.name, "size_bytes": source.size_bytes, "sha256": source.sha256}


def parameters_of(cause: Cause) -> dict[str, dict[str, Any]]:
    """Return the parameters of a cause, as ``numbers_of`` does."""
    return numbers_of(cause.fitted, cause.units)


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


def _size(size: Size) -> dict[str, Any]:
    interval = [_round(bound) for bound in size.closed_interval]
    return {**sizes(size), "closed_interval": interval, "floor_nT": _round(to_nanotesla(size.floor_T))}


def sizes(gap: Size | Closing) -> dict[str, Any]:
    """Return what a gap was and what is left of it: in noise floors, nT and nT/m, and the part that closes."""
    fields = {"before": gap.before_T, "after": gap.after_T}
    gradients = {"before": gap.before_T_per_m, "after": gap.after_T_per_m}
    return {
        **rounded({"before": gap.before, "after": gap.after, "closed": gap.closed}),
        "closed_interval": list(gap.closed_interval),
        **rounded({f"{name}_nT": to_nanotesla(value) for name, value in fields.items()}),
        **rounded({f"{name}_nT_per_m": to_nanotesla(value) for name, value in gradients.items()}),
    }


def _noise(noise: AxisNoise) -> dict[str, Any]:
    """Return the noise of a row: its level with standard error, its white part and colour, and as stated."""
    names = ("level", "standard_error", "white", "stated")
    levels = noise.level_T, noise.level_error_T, noise.white_T, noise.stated_T
    sized = {f"{name}_nT": _round(to_nanotesla(level)) for name, level in zip(names, levels, strict=True)}
    return {"sensor": noise.sensor or "scalar", "axis": noise.axis or None, **sized, "colour": noise.colour}


def _checks(checks: Checks) -> dict[str, Any]:
    """Return what departs from the twin, and each statistic of each row beside its range in the twin."""
    last = len(checks.line_hz) - 1
    rows = [
        {
            "sensor": "scalar" if row == last else row // 3 + 1,
            "axis": None if row == last else "xyz"[row % 3],
            **{name: _check(check, row) for name, check in checks.by_name.items()},
            "line_Hz": _round(checks.line_hz[row]),
            "autocorrelation": [_round(value) for value in checks.autocorrelation[row]],
        }
        for row in range(last + 1)
    ]
    return {"departs": list(checks.sentences), "rows": rows}


def _check(check: Check, row: int) -> dict[str, Any]:
    return {"value": _round(check.values[row]), "twin": [_round(check.low[row]), _round(check.high[row])]}


def _where(where: Where) -> dict[str, Any]:
    return {
        "sensors": list(where.sensors),
        "axes": list(where.axes),
        "time_s": where.time_s and [_round(time) for time in where.time_s],
        "frequency_hz": where.frequency_hz and [_round(frequency) for frequency in where.frequency_hz],
        "evidence": rounded(where.evidence),
    }


def _cause(cause: Cause) -> dict[str, Any]:
    return {
        "effect": cause.fitted.effect,
        "sensors": list(cause.sensors),
        "axes": list(cause.axes),
        **rounded({"probability": cause.probability, "share": cause.share}),
        "parameters": parameters_of(cause),
        "evidence": rounded({"delta_bic": cause.delta_bic, "r2_cv": cause.r2_cv}),
        "indistinguishable_from": list(cause.indistinguishable_from),
        "sizes": [_sized(sized) for sized in cause.sizes],
    }


def _sized(sized: Sized) -> dict[str, Any]:
    """Return a size beside the largest known in nature, and who knows."""
    factor, unit = for_people(sized.limit.unit)
    values = rounded({"value": factor * abs(sized.value), "largest_known": factor * sized.limit.largest})
    return {"name": sized.name, **values, "unit": unit, "source": sized.limit.source}


def _considered(considered: Considered) -> dict[str, Any]:
    tried = {"delta_bic": considered.delta_bic, "r2_cv": considered.r2_cv}
    evidence = rounded({name: value for name, value in tried.items() if value is not None})
    return {"effect": considered.effect, "status": considered.status, "why": considered.why, "evidence": evidence}


def _list(values: Iterable[float]) -> list[float]:
    return [_round(float(value)) for value in values]


def rounded(values: Mapping[str, float]) -> dict[str, float]:
    """Return numbers by name without the noise of their conversion."""
    return {name: _round(value) for name, value in values.items()}


def _round(value: float) -> float:
    """Return a number without the noise of its conversion; a time since 1970 keeps its milliseconds."""
    return float(f"{float(value):.{_DIGITS}g}")


_SURVEY_SCHEMA = "tam_calibration/source/1"


def survey_to_mapping(survey: Survey) -> dict[str, Any]:
    """Return what `tam locate --json` prints; NaN where a value is not known."""
    line = survey.line
    return {
        "schema": _SURVEY_SCHEMA,
        "frame": survey.frame,
        "frequency_Hz": line and line.frequency_hz,
        "frequency_standard_error_Hz": line and line.standard_error_hz,
        "regional_field_T": None if survey.regional_T is None else survey.regional_T.tolist(),
        "located": int(survey.solutions.is_located.sum()),
        "refused": {status.name.lower(): count for status, count in survey.refusals.items()},
        "overall": survey.overall and _overall(survey.overall),
        "targets": [] if survey.overall is None else [_as_target(survey.overall)],
        "samples": [_sample(survey, index) for index in range(len(survey.time_s))],
    }


def _overall(overall: Overall) -> dict[str, Any]:
    return {
        "position_m": overall.position_m.tolist(),
        "position_standard_errors_m": standard_errors(overall.position_covariance_m2).tolist(),
        "position_covariance_m2": overall.position_covariance_m2.tolist(),
        "moment_Am2": overall.moment_Am2.tolist(),
        "moment_standard_errors_Am2": standard_errors(overall.moment_covariance_A2m4).tolist(),
        "moment_covariance_A2m4": overall.moment_covariance_A2m4.tolist(),
        "chi_square": overall.chi_square,
        "degrees_of_freedom": overall.degrees_of_freedom,
    }


def _as_target(overall: Overall) -> dict[str, Any]:
    """Return a source as the targets of a line are told: its evidence is the square of its moment over its errors."""
    moment = overall.moment_Am2
    return {
        "position_m": overall.position_m.tolist(),
        "standard_error_m": standard_errors(overall.position_covariance_m2).tolist(),
        "moment_A_m2": moment.tolist(),
        "evidence": float(moment @ np.linalg.solve(overall.moment_covariance_A2m4, moment)),
        "extended": False,
    }


def _sample(survey: Survey, index: int) -> dict[str, Any]:
    solutions = survey.solutions
    sample = {
        "time_s": float(survey.time_s[index]),
        "status": Status(int(solutions.status[index])).name.lower(),
    }
    if not solutions.is_located[index]:
        return sample
    return sample | {
        "position_m": solutions.position_m[index].tolist(),
        "position_standard_errors_m": survey.position_standard_errors_m[index].tolist(),
        "position_covariance_m2": solutions.position_covariance_m2[index].tolist(),
        "moment_Am2": solutions.moment_Am2[index].tolist(),
        "moment_standard_errors_Am2": survey.moment_standard_errors_Am2[index].tolist(),
        "moment_covariance_A2m4": solutions.moment_covariance_A2m4[index].tolist(),
        "array_center_m": survey.center_m[index].tolist(),
    }
