"""The files of `tam locate`: JSON, targets as CSV or GeoJSON (RFC 7946), and a map of the field as netCDF."""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.linalg import norm

from tam_calibration.files.text_files import to_json, write_text
from tam_calibration.localization.solutions import WORLD_FRAME, EulerSolutions, Overall, Status, Survey, standard_errors
from tam_calibration.localization.targets import Target
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import to_nanotesla
from tam_calibration.recordings.intake import geographic
from tam_calibration.results.results_json import attributes

if TYPE_CHECKING:
    from tam_calibration.localization.targets import FieldMap

_CSV, _GEOJSON = ".csv", ".geojson"

Origin = tuple[float, float, float]
"""Latitude and longitude, degrees, and height, metres, of the position 0, 0, 0."""


def require_table(path: Path, origin: Origin | None) -> None:
    """Check that targets can be written to a path.

    Raises
    ------
    InputError
        When it ends neither in .csv nor in .geojson, or GeoJSON has no origin.
    """
    if path.suffix not in (_CSV, _GEOJSON):
        raise InputError(f"--targets must end in .csv or .geojson, not {path.name!r}")
    if path.suffix == _GEOJSON and origin is None:
        raise InputError("GeoJSON has latitude and longitude: state --origin LAT,LON of x = y = 0")


def write_targets(path: Path, targets: Sequence[Target], origin: Origin | None = None, *, suffix: str) -> None:
    """Write a table of targets, one row or feature each.

    Parameters
    ----------
    path : Path
        The file.
    targets : sequence of Target
        In the order of the list.
    origin : tuple of float, optional
        Of the positions; without it there are no latitudes and longitudes.
    suffix : str
        ``.csv`` or ``.geojson``.
    """
    rows = [_row(number, each) for number, each in enumerate(targets, 1)]
    if origin is not None and targets:
        places = geographic(np.array([each.position_m for each in targets]), np.array(origin))
        for row, place in zip(rows, places.tolist(), strict=True):
            row |= dict(zip(("lat_deg", "lon_deg", "height_m"), place, strict=True))
    write_text(path, _geojson(rows) if suffix == _GEOJSON else _table(rows))


def _row(number: int, target: Target) -> dict[str, Any]:
    moment = target.moment_Am2
    size = float(norm(moment))
    return {
        "number": number,
        **_components("m", target.position_m),
        **_components("standard_error_m", target.standard_errors_m),
        "distance_m": target.distance_m,
        "moment_A_m2": size,
        **_components("A_m2", moment, "moment_"),
        **_components("standard_error_A_m2", standard_errors(target.moment_covariance_A2m4), "moment_"),
        "moment_along_field_A_m2": target.along_field_Am2,
        "iron_sphere_diameter_m": target.sphere_diameter_m,
        "kind": "extended" if target.is_extended else "dipole",
        "extent_m": target.extent_m,
        "evidence": target.evidence,
        "misfit": target.misfit,
        "lines": target.lines,
        "repeat_m": target.repeat_m if target.lines > 1 else "",
    }


def _components(unit: str, vector: np.ndarray, before: str = "") -> dict[str, float]:
    return {f"{before}{axis}_{unit}": float(value) for axis, value in zip("xyz", vector, strict=True)}


def _table(rows: Sequence[dict[str, Any]]) -> str:
    text = StringIO()
    header = list(rows[0]) if rows else ["number", "x_m", "y_m", "z_m"]
    writer = csv.DictWriter(text, header, lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({name: f"{value:.9g}" if isinstance(value, float) else value for name, value in row.items()})
    return text.getvalue()


def _geojson(rows: Sequence[dict[str, Any]]) -> str:
    features = [
        {
            "type": "Feature",
            "geometry": {"type": "Point", "coordinates": [row["lon_deg"], row["lat_deg"], row["height_m"]]},
            "properties": row,
        }
        for row in rows
    ]
    return to_json({"type": "FeatureCollection", "features": features})


def write_map(path: Path, field: "FieldMap", origin: Origin | None = None) -> None:
    """Write a map; with an origin its axes are latitude and longitude.

    Parameters
    ----------
    path : Path
        The file.
    field : FieldMap
        The map.
    origin : tuple of float, optional
        Latitude and longitude, degrees, and height, metres, of the position 0, 0.
    """
    from scipy.io import netcdf_file

    x, y = ("x", "x_m", "m", field.x_m), ("y", "y_m", "m", field.y_m)
    if origin is not None:
        places = np.zeros((len(field.x_m) + len(field.y_m), 3))
        places[: len(field.x_m), 0], places[len(field.x_m) :, 1] = field.x_m, field.y_m
        degrees = geographic(places, np.array(origin))
        x = ("lon", "longitude", "degrees_east", degrees[: len(field.x_m), 1])
        y = ("lat", "latitude", "degrees_north", degrees[len(field.x_m) :, 0])
    with netcdf_file(path, "w") as file:
        file.Conventions = "CF-1.8"
        for name, meaning, unit, values in (y, x):
            file.createDimension(name, len(values))
            axis = file.createVariable(name, "f8", (name,))
            axis[:] = values
            axis.units, axis.long_name = unit, meaning
        for name, unit, values in (
            ("anomaly_nT", "nT", to_nanotesla(field.anomaly_T)),
            ("contraction_nT_per_m", "nT m-1", to_nanotesla(field.contraction_T_per_m)),
        ):
            grid = file.createVariable(name, "f4", (y[0], x[0]))
            grid[:] = values
            grid.units = unit


def targets_to_mapping(targets: Sequence[Target], notes: Sequence[str]) -> dict[str, Any]:
    """Return what `tam locate --json` prints of survey lines, the target with the strongest evidence first.

    Notes say how the attitudes of the lines were improved.
    """
    return {
        "schema": "tam_calibration/targets/1",
        "frame": WORLD_FRAME.partition(",")[0],
        "targets": [_target(each) for each in targets],
        "notes": list(notes),
    }


def _target(target: Target) -> dict[str, Any]:
    return {
        **attributes(target, "position_m"),
        "standard_error_m": target.standard_errors_m.tolist(),
        **attributes(target, "position_covariance_m2"),
        "moment_A_m2": target.moment_Am2.tolist(),
        "moment_standard_error_A_m2": standard_errors(target.moment_covariance_A2m4).tolist(),
        **attributes(target, "evidence", "distance_m"),
        "extended": target.is_extended,
        **attributes(target, "extent_m", "misfit"),
        "moment_along_field_A_m2": target.along_field_Am2,
        "iron_sphere_diameter_m": target.sphere_diameter_m,
        **attributes(target, "lines", "repeat_m"),
    }


def survey_to_mapping(survey: Survey) -> dict[str, Any]:
    """Return what `tam locate --json` prints; NaN where a value is not known."""
    line, overall = survey.line, survey.overall
    return {
        "schema": "tam_calibration/source/1",
        "frame": survey.frame,
        "frequency_Hz": line and line.frequency_hz,
        "frequency_standard_error_Hz": line and line.standard_error_hz,
        "regional_field_T": None if survey.regional_T is None else survey.regional_T.tolist(),
        "located": int(survey.solutions.is_located.sum()),
        "refused": {status.name.lower(): count for status, count in survey.refusals.items()},
        "overall": overall and _source(overall) | attributes(overall, "chi_square", "degrees_of_freedom"),
        "targets": [] if overall is None else [_as_target(overall)],
        "samples": [_sample(survey, index) for index in range(len(survey.time_s))],
    }


def _source(found: Overall | EulerSolutions, index: Any = ...) -> dict[str, Any]:
    """Return position (3,) and moment (3,) of a source, SI, each with its standard errors and its covariance."""
    position_covariance_m2 = found.position_covariance_m2[index]
    moment_covariance_A2m4 = found.moment_covariance_A2m4[index]
    return {
        "position_m": found.position_m[index].tolist(),
        "position_standard_errors_m": standard_errors(position_covariance_m2).tolist(),
        "position_covariance_m2": position_covariance_m2.tolist(),
        "moment_Am2": found.moment_Am2[index].tolist(),
        "moment_standard_errors_Am2": standard_errors(moment_covariance_A2m4).tolist(),
        "moment_covariance_A2m4": moment_covariance_A2m4.tolist(),
    }


def _as_target(overall: Overall) -> dict[str, Any]:
    """Return a source in the form of a target; its evidence is the squared moment over its covariance."""
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
    status = Status(int(solutions.status[index])).name.lower()
    sample = {"time_s": float(survey.time_s[index]), "status": status}
    if not solutions.is_located[index]:
        return sample
    return {**sample, **_source(solutions, index)}
