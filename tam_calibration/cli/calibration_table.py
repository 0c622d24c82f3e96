"""A calibration as tables for people in a terminal."""

import numpy as np
from rich.console import Console
from rich.table import Table

from tam_calibration.array import OUTPUT_NAMES, TENSOR_OUTPUTS
from tam_calibration.calibration import AmbientGradient, Calibration, KnownSource
from tam_calibration.files import FORMULA
from tam_calibration.fit.coverage import Coverage
from tam_calibration.fit.weakness import Weakness
from tam_calibration.report.effect_rows import NUMBERS_HEADER, effect_number_rows
from tam_calibration.report.formatting import number, sentence, with_error
from tam_calibration.report.parameter_rows import parameter_rows
from tam_calibration.residuals import Residuals
from tam_calibration.units import to_degrees, to_nanotesla


def print_calibration(console: Console, calibration: Calibration, coverage: Coverage, weakness: Weakness) -> None:
    """Print parameters, residuals, coverage, what to know, and how to apply the calibration by hand."""
    console.print(_parameters(calibration))
    if calibration.effects:
        console.print(_effects(calibration))
    console.print(_residuals(calibration))
    intensity = number(to_nanotesla(calibration.intensity_T), 6)
    reference = "from the scalar reference" if calibration.has_scalar_reference else "fitted, on an unknown scale"
    console.print(f"Field: {intensity} nT, {reference}. Samples: {calibration.samples}.")
    if calibration.ambient_gradient is not None:
        console.print(_gradient(calibration.ambient_gradient))
    if calibration.known_source is not None:
        console.print(_known_source(calibration.known_source))
    console.print(f"Coverage: {calibration.coverage:.0%} of the sphere. {sentence(coverage.advice)}")
    if weakness.parameters:
        console.print(str(weakness))
    if calibration.noise_is_estimated:
        console.print("Noise: not stated in the array file, estimated from the recording's fast differences.")
    for warning in calibration.warnings:
        console.print(f"Warning: {sentence(warning)}", style="bold")
    for statement in calibration.statements:
        console.print(statement)
    console.print(f"By hand: {FORMULA}")


def _parameters(calibration: Calibration) -> Table:
    table = Table("parameter", title=f"Errors of the sensors ± standard errors ({calibration.method})")
    for sensor in range(calibration.errors.sensor_count):
        table.add_column(f"sensor {sensor + 1}", justify="right")
    for row in parameter_rows(calibration):
        table.add_row(*row)
    return table


def _effects(calibration: Calibration) -> Table:
    table = Table(*NUMBERS_HEADER, title="Effects beside the errors ± standard errors")
    for row in effect_number_rows(calibration):
        table.add_row(*row)
    return table


def _known_source(found: KnownSource) -> str:
    degrees = zip(to_degrees(found.rotation), to_degrees(found.rotation_standard_errors), strict=True)
    turn = ", ".join(with_error(float(value), float(error), 3) for value, error in degrees)
    return (
        f"Known source: baselines {with_error(found.baseline_scale, found.baseline_scale_standard_error, 4)} times "
        f"those stated; frame turned by {turn}° about x, y, z; places of the axes to "
        f"{number(1e3 * float(found.axis_offsets_standard_errors_m.max()))} mm; reduced χ² "
        f"{number(found.reduced_chi_square)}."
    )


def _gradient(gradient: AmbientGradient) -> str:
    values, errors = to_nanotesla(gradient.tensor_T_per_m), to_nanotesla(gradient.standard_errors_T_per_m)
    parts = (
        f"{name} {with_error(float(values[place]), float(errors[place]), 2)}"
        for name, place in zip(OUTPUT_NAMES[3:], zip(*np.triu_indices(3), strict=True), strict=True)
    )
    return f"Gradient of the field in the world of the attitude (nT/m): {', '.join(parts)}."


def _residuals(calibration: Calibration) -> Table:
    columns = {
        "before": calibration.before,
        "in sample": calibration.in_sample,
        "held out": calibration.held_out,
        "noise floor": calibration.floor,
    }
    present = {name: _rows(residuals) for name, residuals in columns.items() if residuals is not None}
    table = Table("RMS residual", title="Residuals in a uniform field")
    for name in present:
        table.add_column(name, justify="right")
    for quantity in present["before"]:
        table.add_row(quantity, *(number(rows[quantity], 4) for rows in present.values()))
    return table


def _rows(residuals: Residuals) -> dict[str, float]:
    rows = {f"|B| of sensor {k} (nT)": value for k, value in enumerate(residuals.sensor_intensity_T, start=1)}
    rows["|B| at the centre (nT)"] = residuals.center_intensity_T
    if np.isfinite(residuals.tensor_rmse_T_per_m):
        names = (f"{OUTPUT_NAMES[index]} (nT/m)" for index in TENSOR_OUTPUTS)
        rows |= dict(zip(names, residuals.tensor_T_per_m, strict=True))
        rows["tensor, root of the sum of squares (nT/m)"] = residuals.tensor_rmse_T_per_m
    return {name: to_nanotesla(float(value)) for name, value in rows.items()}
