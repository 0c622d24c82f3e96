"""The calibration file: everything of a calibration, with the formula to apply it by hand."""

from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import KnownSource, Moved, Quality, Update
from tam_calibration.effects.library import units_of
from tam_calibration.files.schema import NOT_TURNED, block_to_write, part_to_mapping, value_to_write
from tam_calibration.files.text_files import in_file, read_text, write_text
from tam_calibration.files.yaml_document import dump_mapping, parse_mapping
from tam_calibration.model.sensor_errors import Residuals, SensorErrors, orientation_to_axes
from tam_calibration.model.units import ERROR_KINDS, FloatArray, to_nanotesla
from tam_calibration.recordings.array_yaml import array_to_mapping
from tam_calibration.results import calibration_schema
from tam_calibration.results.effects_schema import effect_to_mapping

FORMULA = (
    "Field at a sensor in the array frame [nT] = inverse of its matrix × (its raw reading [nT] - its bias_nT). "
    "The centre vector b and the gradient tensor G are the least-squares fit of b + G × position to the fields of all "
    "sensors, G symmetric with zero trace. If the positions do not determine G, b is the mean of the fields."
)
_COVARIANCE_ORDER = (
    "For each sensor in turn: scale factors x y z [1], non-orthogonality theta phi psi [rad], bias x y z [T], "
    "misalignment alpha beta gamma [rad]. What the data did not determine was fixed and is 0."
)


def read_calibration(path: str | Path) -> Calibration:
    """Read a calibration file.

    Parameters
    ----------
    path : str or Path
        The YAML file.

    Returns
    -------
    Calibration
        In SI; its numbers are those that were written, to the last bit.

    Raises
    ------
    InputError
        When it cannot be read, is of another version, or is damaged.

    Examples
    --------
    >>> from tam_calibration import calibrate, read_calibration, read_scenario, simulate, write_calibration
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> write_calibration("calibration.yaml", calibrate(made.recording, made.scenario.array))
    >>> read_calibration("calibration.yaml").method
    'maximum_likelihood'
    """
    path = Path(path)
    return calibration_from_yaml(read_text(path), str(path))


def write_calibration(path: str | Path, calibration: Calibration) -> None:
    """Write a calibration file.

    Parameters
    ----------
    path : str or Path
        The YAML file; one that is there is replaced once the new one is complete.
    calibration : Calibration
        What it shall hold; biases are written in nT, angles in degrees, the covariance in SI.

    Raises
    ------
    InputError
        When the file cannot be written.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tam_calibration import calibrate, read_scenario, simulate, write_calibration
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> write_calibration("calibration.yaml", calibrate(made.recording, made.scenario.array))
    >>> print(Path("calibration.yaml").read_text().splitlines()[0])
    schema: tam_calibration/calibration/1
    """
    write_text(Path(path), calibration_to_yaml(calibration))


def calibration_from_yaml(text: str, where: str) -> Calibration:
    """Return the calibration that a text contains.

    Parameters
    ----------
    text : str
        Content of a calibration file.
    where : str
        Path or topic that the text came from, for the message of an `InputError`.

    Raises
    ------
    InputError
        When it is of another version, or is damaged.
    """
    with in_file(where):
        return calibration_schema.calibration_of(parse_mapping(text))


def calibration_to_yaml(calibration: Calibration) -> str:
    """Return the text of a calibration file."""
    return dump_mapping(calibration_to_mapping(calibration))


def quality_to_mapping(quality: Quality) -> dict[str, Any]:
    """Return the grade of a calibration, its reasons, and what to do next."""
    return {"grade": quality.grade, "reasons": list(quality.reasons), "next": list(quality.next)}


def calibration_to_mapping(calibration: Calibration) -> dict[str, Any]:
    """Return the content of a calibration file: numbers that are read again are exact, those for people rounded."""
    return {
        "schema": calibration_schema.SCHEMA,
        "software": f"tam_calibration {__version__}",
        "method": calibration.method,
        "quality": quality_to_mapping(calibration.quality),
        "formula": FORMULA,
        "frame": calibration.frame,
        "statements": list(calibration.statements[1:]),
        "warnings": list(calibration.warnings),
        **_without_empty(notes=list(calibration.notes), accepted=list(calibration.accepted)),
        "sensors": sensors_to_mapping(calibration.errors, calibration.standard_errors),
        "array": array_to_mapping(calibration.array) | {"noise_is_estimated": calibration.noise_is_estimated},
        "field": {
            "intensity_nT": value_to_write("_nT", calibration.intensity_T),
            "has_scalar_reference": calibration.has_scalar_reference and not calibration.reference,
            **_without_empty(reference=calibration.reference),
            "coverage_of_sphere": _rounded(calibration.coverage),
        },
        "residuals": {
            "before": _residuals(calibration.before),
            "in_sample": _residuals(calibration.in_sample),
            "held_out": calibration.held_out and _residuals(calibration.held_out),
            "noise_floor": _residuals(calibration.floor),
        },
        "reduced_chi_square": {name: _rounded(value) for name, value in calibration.reduced_chi_square.items()},
        **_without_empty(
            effects=_effects(calibration),
            known_source=calibration.known_source and _known_source(calibration.known_source),
            update=calibration.update and _update(calibration.update),
        ),
        "recording": {
            "samples": calibration.samples,
            "time_span_s": list(calibration.time_span_s),
            **{name: getattr(calibration.source, name, None) for name in ("name", "size_bytes", "sha256")},
            **_without_empty(mean_temperature_C=calibration.temperature_C),
        },
        "covariance_order": _COVARIANCE_ORDER,
        "covariance_SI": calibration.covariance.tolist(),
    }


def _without_empty(**values: Any) -> dict[str, Any]:
    """Return the values of keys that older files do not have, where there are any."""
    return {key: value for key, value in values.items() if value is not None and value != []}


def _known_source(found: KnownSource) -> dict[str, Any]:
    block = block_to_write(calibration_schema.KnownSourceFile, astuple(found))
    exact = ("baseline_scale", "rotation_deg")
    return {key: value if key in exact else _rounded(value) for key, value in block.items()}


def _update(update: Update) -> dict[str, Any]:
    """Return what a calibration took from the one before it, for people and programs: it is not read again."""
    return {
        "prior": update.prior,
        "change_rates": part_to_mapping(update.rates),
        "elapsed_s": update.elapsed_s,
        "warming_K": update.warming_K,
        "prior_standard_errors_SI": update.prior_standard_errors.tolist(),
        "data_share": update.data_share.tolist(),
        "chi_square": update.chi_square,
        "freedom": update.freedom,
        "probability": update.probability,
        "moved": [_moved(each) for each in update.moved],
    }


def _moved(moved: Moved) -> dict[str, Any]:
    unit = next(kind.unit for kind in ERROR_KINDS if kind.name == moved.kind)
    values = {"change": moved.change, "standard_error": moved.standard_errors}
    return {
        **_change((moved.kind, moved.sensor)),
        **{f"{name}_{unit}".rstrip("_"): value_to_write(unit, value) for name, value in values.items()},
        "probability": moved.probability,
        "rivals": [_change(rival) for rival in moved.rivals],
        "since_s": moved.since_s,
        "together": moved.together and _change(moved.together),
    }


def _change(change: tuple[str, int]) -> dict[str, Any]:
    return dict(zip(("kind", "sensor"), change, strict=True))


def _effects(calibration: Calibration) -> list[dict[str, Any]]:
    return [
        effect_to_mapping(fitted, units_of(fitted, calibration.errors, calibration.array))
        | {"size": _of_outputs(size.rms), "size_standard_error": _of_outputs(size.standard_errors)}
        for fitted, size in zip(calibration.effects, calibration.effect_sizes, strict=True)
    ]


def _of_outputs(nine: FloatArray) -> dict[str, list[float]]:
    rounded = _rounded(to_nanotesla(nine))
    return {"field_nT": rounded[:3], "gradient_nT_per_m": rounded[3:]}


def sensors_to_mapping(errors: SensorErrors, standard_errors: FloatArray | None = None) -> list[dict[str, Any]]:
    """Return the errors of all sensors as files have them, one block for each.

    Parameters
    ----------
    errors : SensorErrors
        Of K sensors; the orientation of one that has none is left out.
    standard_errors : (K, 12) array, optional
        Theirs, SI.
    """
    values, blocks = errors.to_vector(), []
    for index, matrix in enumerate(errors.matrix.tolist()):
        block: dict[str, Any] = {"sensor": index + 1}
        for place, kind in enumerate(ERROR_KINDS):
            own = slice(3 * place, 3 * place + 3)
            block[kind.key()] = value_to_write(kind.unit, values[index, own])
            if standard_errors is not None:
                block[kind.key("standard_error")] = _rounded(value_to_write(kind.unit, standard_errors[index, own]))
        axes = orientation_to_axes(errors.orientation[index])
        blocks.append(block | ({} if tuple(axes) == NOT_TURNED else {"orientation": axes}) | {"matrix": matrix})
    return blocks


def _residuals(residuals: Residuals) -> dict[str, Any]:
    block = block_to_write(calibration_schema.ResidualsFile, (*astuple(residuals), residuals.tensor_rmse_T_per_m))
    return {key: _rounded(value) for key, value in block.items()}


def _rounded(value: Any) -> Any:
    """Return the value, or list of values, to six significant digits."""
    return np.vectorize(lambda number: float(f"{number:.6g}"), otypes=[float])(value).tolist()
