"""The simulation of Li 2018a: 18³ poses in 55 000 nT, Tables 1 to 3.

What reproduces the printed numbers: poses Ry Rx Rz with the turn about z fastest, misalignment Rx(α) Ry(β) Rz(γ) from
the platform to the sensor, and noise of 1/√3 nT on each axis of each sensor before the distortion. What is measured is
in the file of what it prints.
"""

from typing import Any

import numpy as np

from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import procrustes, rotation_by_regression
from tam_calibration.fit.published import regress, simplified_linear, two_step_linear
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.cross import COMPONENTS, SENSORS, SetUp, grid_of_turns, observed, site_field
from tam_validation.papers.printed import finding, printed_in
from tam_validation.papers.row import PaperNumber, compare

_TURNS = 18
_BASELINE_M = 0.5
_NOISE_T = from_nanotesla(1 / np.sqrt(3))

_PRINTED = printed_in("li2018a")
PRESET, _ESTIMATED = np.array(_PRINTED["preset"]), np.array(_PRINTED["estimated"])
"""Rows ``_PARAMETERS`` of Table 3, columns the four sensors."""
_ANGLES = ("θ", "φ", "ψ", "α", "β", "γ")
_PARAMETERS = ("θ", "φ", "ψ", "c_x", "c_y", "c_z", "i_x", "i_y", "i_z", "α", "β", "γ")
_UNITS = ("°",) * 3 + ("1",) * 3 + ("nT",) * 3 + ("°",) * 3
_TOLERANCES = (0.004,) * 3 + (1e-4,) * 3 + (0.05,) * 3 + (0.004,) * 3


_ACCURACY_PERCENT = _PRINTED["accuracy_percent"]


def set_up(seed: int = 0) -> SetUp:
    """Return the cross of Table 3 and its readings."""
    site = site_field(from_nanotesla(55_000.0), 60.0, -7.0)
    return observed(errors_of(PRESET), grid_of_turns("YXZ", _TURNS, site), _BASELINE_M, _NOISE_T, seed)


def errors_of(table: FloatArray) -> SensorErrors:
    """Return the errors of a table (12, 4) in the order of ``PRESET``; the paper's θ is our φ, and its φ our θ."""
    theta, phi, psi, *rest = table
    scale, bias, misalignment = np.split(np.array(rest), 3)
    angles = from_degrees(np.stack([phi, theta, psi], axis=1))
    return SensorErrors(scale.T, angles, from_nanotesla(bias.T), from_degrees(misalignment.T))


def table_of(errors: SensorErrors) -> FloatArray:
    """Return the table (12, 4) of errors, the inverse of ``errors_of``."""
    angles = to_degrees(errors.non_orthogonality[:, [1, 0, 2]])
    columns = [angles, errors.scale_factor, to_nanotesla(errors.bias_T), to_degrees(errors.misalignment)]
    return np.concatenate(columns, axis=1).T


def results() -> list[PaperNumber]:
    """Return the numbers of Tables 1 to 3 and what section 3.3 says of the frame, the paper's beside ours."""
    case = set_up()
    fitted = _errors_from_true_field(case)
    fields = stages(case)
    rows = []
    for stage, values in fields.items():
        names = [f"Table 1, TMI, {stage}, {sensor}" for sensor in SENSORS]
        ours = to_nanotesla(case.intensity_rms_T(values))
        rows += finding("li2018a", f"TMI, {stage}", ours, names=names, paper=_PRINTED["table_1"][stage])
    for stage, values in fields.items():
        names = [f"Table 2, {component}, {stage}" for component in COMPONENTS]
        ours = to_nanotesla(case.tensor_rms_T_per_m(values))
        rows += finding("li2018a", f"tensor, {stage}", ours, names=names, paper=_PRINTED["table_2"][stage])
    return rows + _parameter_rows(fitted) + _accuracy_rows(fitted) + _frame_rows(case)


def stages(case: SetUp) -> dict[str, FloatArray]:
    """Return the fields (N, 4, 3) before calibration and after that of each method, by the names of Tables 1 and 2."""
    return {
        "before": case.recording.readings_T,
        "Zhang": _align_by_first_turn(case, simplified_linear(case.recording, case.array).errors),
        "Yin": _align_by_first_turn(case, two_step_linear(case.recording, case.array).errors),
        "theirs": _errors_from_true_field(case).restore(case.recording.readings_T),
    }


def _align_by_first_turn(case: SetUp, errors: SensorErrors) -> FloatArray:
    """Return the (N, 4, 3) fields of calibrated sensors, each aligned to the platform by regression on the first turn.

    Tables 1 and 2 show that this is how the paper aligned the methods it compares itself with.
    """
    zero = np.zeros_like(errors.misalignment)
    own = SensorErrors(errors.scale_factor, errors.non_orthogonality, errors.bias_T, zero)
    fields = own.restore(case.recording.readings_T)
    first = slice(0, _TURNS)
    regression = [np.linalg.lstsq(fields[first, sensor], case.field_T[first], rcond=None)[0].T for sensor in range(4)]
    return np.asarray(np.einsum("kji,nkj->nki", rotation_by_regression(np.array(regression)), fields))


def _errors_from_true_field(case: SetUp) -> SensorErrors:
    """Return the twelve parameters of each sensor fitted to the true field, which served as reference in Table 3."""
    readings = case.recording.readings_T / case.intensity_T
    rows = np.concatenate([readings, np.ones((*readings.shape[:2], 1))], axis=2)
    square = np.einsum("nki,nkj->kij", rows, rows)
    cross = np.einsum("nki,nj->kij", rows, case.field_T / case.intensity_T)
    unmix, bias = regress(square, cross)
    return SensorErrors.from_matrix(np.linalg.inv(unmix), case.intensity_T * bias)


def artificial_frame(case: SetUp) -> FloatArray:
    """Return the angles (3,) α, β, γ by which the artificial vector's frame is turned from the platform, radians."""
    mean = case.recording.readings_T.mean(axis=1) / case.intensity_T
    rows = ellipsoid.monomial_columns(mean.T, np.ones(len(mean))).T
    moments = rows.T @ rows
    center = ellipsoid.center_of(moments)
    artificial = (mean - center) @ ellipsoid.square_root(ellipsoid.shape_about(moments, center)).T
    rotation = procrustes((artificial.T @ case.field_T)[None])
    return np.asarray(SensorErrors.from_matrix(rotation, np.zeros((1, 3))).misalignment[0])


def _parameter_rows(fitted: SensorErrors) -> list[PaperNumber]:
    rows = []
    for name, unit, tolerance, printed, ours in zip(
        _PARAMETERS, _UNITS, _TOLERANCES, _ESTIMATED, table_of(fitted), strict=True
    ):
        names = [f"Table 3, {name}, {sensor}" for sensor in SENSORS]
        rows += compare(names, printed.tolist(), ours, unit, absolute=tolerance)
    return rows


def _accuracy_rows(fitted: SensorErrors) -> list[PaperNumber]:
    own = _accuracy_percent(_ESTIMATED)
    rows = []
    for name, printed, ours, of_printed in zip(
        _PARAMETERS, _ACCURACY_PERCENT, _accuracy_percent(table_of(fitted)), own, strict=True
    ):
        recorded = "not reproduced" if name in _ANGLES else "reproduced"
        stated: dict[str, Any] = {"names": [f"Table 3, PMEA, {name}"], "paper": [printed], "recorded": recorded}
        rows += finding("li2018a", "accuracy", [ours], told={"of_printed": of_printed}, **stated)
    return rows


def _accuracy_percent(table: FloatArray) -> FloatArray:
    """Return the PMEA (12,) of a table (12, 4) of estimates."""
    return np.asarray(100 * (1 - np.abs(table / PRESET - 1).max(axis=1)))


def _frame_rows(case: SetUp) -> list[PaperNumber]:
    return finding("li2018a", "frame", to_degrees(artificial_frame(case)))
