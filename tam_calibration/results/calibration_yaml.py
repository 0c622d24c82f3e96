"""The calibration file: everything of a calibration, with the formula to apply it by hand."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration import __version__
from tam_calibration.correction.calibration import AmbientGradientEstimate, Calibration, KnownSource
from tam_calibration.correction.quality import Quality
from tam_calibration.effects.library import units_of
from tam_calibration.files.quantities import NOT_TURNED
from tam_calibration.files.text_files import degrees_to_write, in_file, nanotesla_to_write, read_text, write_text
from tam_calibration.files.yaml_document import dump_mapping, parse_mapping
from tam_calibration.model.residuals import Residuals
from tam_calibration.model.sensor_errors import SensorErrors, orientation_to_axes
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla
from tam_calibration.recordings.array_yaml import array_to_mapping
from tam_calibration.results.calibration_schema import SCHEMA, calibration_of
from tam_calibration.results.effects_schema import effect_to_mapping
from tam_calibration.results.update_schema import update_to_mapping

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
        return calibration_of(parse_mapping(text))


def calibration_to_yaml(calibration: Calibration) -> str:
    """Return the text of a calibration file."""
    return dump_mapping(calibration_to_mapping(calibration))


def quality_to_mapping(quality: Quality) -> dict[str, Any]:
    """Return the grade of a calibration, its reasons, and what to do next."""
    return {"grade": quality.grade, "reasons": list(quality.reasons), "next": list(quality.next)}


def calibration_to_mapping(calibration: Calibration) -> dict[str, Any]:
    """Return the content of a calibration file: numbers that are read again are exact, those for people rounded."""
    source = calibration.source
    return {
        "schema": SCHEMA,
        "software": f"tam_calibration {__version__}",
        "method": calibration.method,
        "quality": quality_to_mapping(calibration.quality),
        "formula": FORMULA,
        "frame": calibration.frame,
        "statements": list(calibration.statements[1:]),
        "warnings": list(calibration.warnings),
        **({"notes": list(calibration.notes)} if calibration.notes else {}),
        **({"accepted": list(calibration.accepted)} if calibration.accepted else {}),
        "sensors": sensors_to_mapping(calibration.errors, calibration.standard_errors),
        "array": array_to_mapping(calibration.array) | {"noise_is_estimated": calibration.noise_is_estimated},
        "field": {
            "intensity_nT": float(nanotesla_to_write(np.array(calibration.intensity_T))),
            "has_scalar_reference": calibration.has_scalar_reference,
            "coverage_of_sphere": _rounded(calibration.coverage),
            **_gradient(calibration.ambient_gradient),
        },
        "residuals": {
            name: None if residuals is None else _residuals(residuals)
            for name, residuals in (
                ("before", calibration.before),
                ("in_sample", calibration.in_sample),
                ("held_out", calibration.held_out),
                ("noise_floor", calibration.floor),
            )
        },
        "reduced_chi_square": {name: _rounded(value) for name, value in calibration.reduced_chi_square.items()},
        **_effects(calibration),
        **_known_source(calibration.known_source),
        **({} if calibration.update is None else {"update": update_to_mapping(calibration.update)}),
        "recording": {
            "samples": calibration.samples,
            "time_span_s": list(calibration.time_span_s),
            "name": source and source.name,
            "size_bytes": source and source.size_bytes,
            "sha256": source and source.sha256,
            **({} if calibration.temperature_C is None else {"mean_temperature_C": calibration.temperature_C}),
        },
        "covariance_order": _COVARIANCE_ORDER,
        "covariance_SI": None if calibration.covariance is None else calibration.covariance.tolist(),
    }


def _known_source(found: KnownSource | None) -> dict[str, Any]:
    if found is None:
        return {}
    return {
        "known_source": {
            "baseline_scale": found.baseline_scale,
            "baseline_scale_standard_error": _rounded(found.baseline_scale_standard_error),
            "rotation_deg": degrees_to_write(found.rotation).tolist(),
            "rotation_standard_error_deg": _rounded(to_degrees(found.rotation_standard_errors)),
            "axis_offsets_standard_error_m": _rounded(found.axis_offsets_standard_errors_m),
            "reduced_chi_square": _rounded(found.reduced_chi_square),
        }
    }


def _gradient(gradient: AmbientGradientEstimate | None) -> dict[str, Any]:
    if gradient is None:
        return {}
    return {
        "gradient_nT_per_m": nanotesla_to_write(gradient.tensor_T_per_m).tolist(),
        "gradient_standard_error_nT_per_m": nanotesla_to_write(gradient.standard_errors_T_per_m).tolist(),
    }


def _effects(calibration: Calibration) -> dict[str, Any]:
    """Return the effects, where there are any: a file without them is one of before they could be kept."""
    if not calibration.effects:
        return {}
    blocks = [
        effect_to_mapping(fitted, units_of(fitted, calibration.errors, calibration.array))
        | {"size": _of_outputs(size.rms), "size_standard_error": _of_outputs(size.standard_errors)}
        for fitted, size in zip(calibration.effects, calibration.effect_sizes, strict=True)
    ]
    return {"effects": blocks}


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
    columns: tuple[tuple[str, str, FloatArray, Callable[[FloatArray], FloatArray]], ...] = (
        ("scale_factor", "", errors.scale_factor, np.asarray),
        ("non_orthogonality", "_deg", degrees_to_write(errors.non_orthogonality), to_degrees),
        ("bias", "_nT", nanotesla_to_write(errors.bias_T), to_nanotesla),
        ("misalignment", "_deg", degrees_to_write(errors.misalignment), to_degrees),
    )
    blocks = []
    for index, matrix in enumerate(errors.matrix.tolist()):
        block: dict[str, Any] = {"sensor": index + 1}
        for place, (name, unit, values, convert) in enumerate(columns):
            block[name + unit] = values[index].tolist()
            if standard_errors is not None:
                own = standard_errors[index, 3 * place : 3 * place + 3]
                block[f"{name}_standard_error{unit}"] = _rounded(convert(own))
        axes = orientation_to_axes(errors.orientation[index])
        blocks.append(block | ({} if tuple(axes) == NOT_TURNED else {"orientation": axes}) | {"matrix": matrix})
    return blocks


def _residuals(residuals: Residuals) -> dict[str, Any]:
    return {
        "sensor_intensity_nT": _rounded(to_nanotesla(residuals.sensor_intensity_T)),
        "center_intensity_nT": _rounded(to_nanotesla(residuals.center_intensity_T)),
        "tensor_nT_per_m": _rounded(to_nanotesla(residuals.tensor_T_per_m)),
        "tensor_rmse_nT_per_m": _rounded(to_nanotesla(residuals.tensor_rmse_T_per_m)),
    }


def _rounded(value: float | FloatArray) -> Any:
    """Return the value, or list of values, to six significant digits."""
    return np.vectorize(lambda number: float(f"{number:.6g}"), otypes=[float])(value).tolist()
