"""What the demonstration gained: figures of the corrected stream against the truth that was simulated."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.linalg import norm
from rich.table import Table

from tam_calibration.array import TENSOR_OUTPUTS
from tam_calibration.calibration import Calibration
from tam_calibration.exceptions import Refused
from tam_calibration.residuals import noise_floor
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.units import FloatArray, to_degrees, to_nanotesla

if TYPE_CHECKING:
    from tam_calibration.simulation import Simulation

ACCEPTED_RATIO = 1.05
"""Largest tensor error over the noise floor that counts as success."""


def true_outputs(run: "Simulation") -> FloatArray:
    """Return the (N, 9) true outputs of a run, in the order of ``OUTPUT_NAMES``."""
    upper = run.gradient_T_per_m[:, *np.triu_indices(3)]
    return np.hstack([run.center_field_T, upper])


def errors_of(run: "Simulation", outputs: FloatArray) -> tuple[float, float]:
    """Return the root mean square errors of |B| at the centre and of the tensor's five components, T and T/m."""
    true = true_outputs(run)
    intensity = norm(outputs[:, :3], axis=1) - norm(true[:, :3], axis=1)
    tensor = (outputs - true)[:, TENSOR_OUTPUTS]
    return float(np.sqrt(np.mean(intensity**2))), float(np.sqrt(np.mean((tensor**2).sum(axis=1))))


def floor_of(run: "Simulation") -> tuple[float, float]:
    """Return what the sensors' noise alone makes of `errors_of`, whatever the calibration."""
    floor = noise_floor(run.errors, run.scenario.array, scalar_noise_T=0.0)
    return floor.center_intensity_T, floor.tensor_rmse_T_per_m


def raw_outputs(run: "Simulation") -> FloatArray:
    """Return the (N, 9) outputs of the raw readings, taken as the field."""
    readings = run.recording.readings_T
    raw: FloatArray = readings.reshape(len(readings), -1) @ run.scenario.array.operator.T
    return raw


def gains_table(run: "Simulation", live: FloatArray) -> Table:
    """Return errors before and after, and the noise floor, of the run that the calibration has not seen."""
    table = Table(title=f"{len(live)} samples of the second run against the truth")
    for heading in ("RMS error", "raw", "corrected, live", "noise floor", "ratio"):
        table.add_column(heading, justify="left" if heading == "RMS error" else "right")
    names = ("|B| at the centre, nT", "tensor, 5 components, nT/m")
    figures = zip(errors_of(run, raw_outputs(run)), errors_of(run, live[:, :9]), floor_of(run), strict=True)
    for name, (before, after, floor) in zip(names, figures, strict=True):
        in_nanotesla = [f"{to_nanotesla(value):.3f}" for value in (before, after, floor)]
        table.add_row(name, *in_nanotesla, f"{after / floor:.4f}")
    return table


def parameter_table(truth: SensorErrors, calibration: Calibration) -> Table:
    """Return size, true error and standard error of each group of parameters, as root mean squares."""
    table = Table(title="Parameters against the truth")
    for heading in ("RMS of", "size", "error of the estimate", "its standard error"):
        table.add_column(heading, justify="left" if heading == "RMS of" else "right")
    size = truth.to_vector() - SensorErrors.none(truth.sensor_count).to_vector()
    error = calibration.errors.to_vector() - truth.to_vector()
    for name, columns, factor in (
        ("scale factor, %", slice(0, 3), 100.0),
        ("non-orthogonality, °", slice(3, 6), to_degrees(1.0)),
        ("bias, nT", slice(6, 9), to_nanotesla(1.0)),
        ("misalignment, °", slice(9, 12), to_degrees(1.0)),
    ):
        # Sensor 1 defines the frame: its misalignment is zero, in truth and estimate.
        rows = slice(1, None) if name.startswith("misalignment") else slice(None)
        parts = (each[rows, columns] for each in (size, error, calibration.standard_errors))
        table.add_row(name, *(f"{factor * np.sqrt(np.mean(part**2)):.3g}" for part in parts))
    return table


def require_success(run: "Simulation", live: FloatArray) -> None:
    """Check that every sample was corrected, and the tensor error is near the noise floor.

    Raises
    ------
    Refused
        With the figures.
    """
    if len(live) != run.recording.sample_count:
        raise Refused(f"{len(live)} of {run.recording.sample_count} samples were corrected")
    ratio = errors_of(run, live[:, :9])[1] / floor_of(run)[1]
    if not ratio <= ACCEPTED_RATIO:
        raise Refused(f"the tensor error is {ratio:.3f} times the noise floor, more than {ACCEPTED_RATIO}")
