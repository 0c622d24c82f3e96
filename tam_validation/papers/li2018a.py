"""Li 2018a: the simulation of 18³ poses in 55 000 nT, Tables 1 to 3, and the experiment, Tables 4 to 6.

What reproduces the printed numbers: poses Ry Rx Rz with the turn about z fastest, misalignment Rx(α) Ry(β) Rz(γ) from
the platform to the sensor, and noise of 1/√3 nT on each axis of each sensor before the distortion.
"""

import numpy as np
from numpy.linalg import norm

from tam_calibration.fit.published import regress
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.cross import (
    SetUp,
    aligned_by_regression,
    grid_of_turns,
    intensity_rms_T,
    observed,
    site_field,
    tensor_rms_T_per_m,
)
from tam_validation.papers.ellipsoids import first_order_fields, orthogonal_fields
from tam_validation.papers.field_experiment import field_experiment, poses
from tam_validation.papers.printed import printed_in
from tam_validation.papers.row import Draws, right_name

_TURNS = 18
_BASELINE_M = 0.5
"""Of the simulation, as the paper states it."""

NOISE_T = from_nanotesla(1 / np.sqrt(3))
_RADIANS, _DEGREES = 4, 3
"""Decimals of an angle: the paper prints radians, and degrees that are worked out of these."""

_EXPERIMENT_T, _SWING_T = from_nanotesla(53_902.87), from_nanotesla(10.0)
"""Field of the experiment and by how much it varies, as the paper states them."""

_RANDOM_POSES = 100

_PRINTED = printed_in("li2018a")
PRESET = np.array(_PRINTED["preset"])
"""Rows θ, φ, ψ, c_x, c_y, c_z, i_x, i_y, i_z, α, β, γ of Table 3, columns the four sensors."""
_ANGLES = [0, 1, 2, 9, 10, 11]
_FRAME = "Section 3.3, turn of the artificial vector from the platform"
_REPRODUCTION = "Section 5, least reproduction degree of two data sets"


def set_up(seed: int = 0) -> SetUp:
    """Return the cross of Table 3 and its readings."""
    site = site_field(from_nanotesla(55_000.0), 60.0, -7.0)
    return observed(errors_of(PRESET), grid_of_turns("YXZ", _TURNS, site), _BASELINE_M, NOISE_T, seed)


def experiment(seed: int, noise_T: float = NOISE_T) -> tuple[SetUp, FloatArray]:
    """Return the cross of section 5 with the errors of Table 6, and its poses; eq. 7 has the angles reversed."""
    table = np.array(_PRINTED["experiment"])
    table[9:] *= -1
    to_world = poses(_RANDOM_POSES, np.random.default_rng([seed, 0]))
    return field_experiment(errors_of(table), _EXPERIMENT_T, _SWING_T, to_world, noise_T, seed), to_world


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


def simulate(seed: int, as_published: bool) -> Draws:
    """Return what one simulation gives, by the findings of the paper.

    Parameters
    ----------
    seed : int
        Of noise and poses.
    as_published : bool
        Whether the sensors are fitted to the artificial vector, as section 3.3 says, and not to the true field, from
        which Table 3 comes out.
    """
    case = set_up(seed)
    artificial = artificial_field(case)
    fitted = _fitted_to(case, artificial if as_published else case.field_T)
    draws = dict[str, FloatArray]()
    for stage, fields in stages(case, fitted).items():
        draws[f"Table 1, TMI, {stage}"] = to_nanotesla(intensity_rms_T(fields, case.intensity_T))
        draws[f"Table 2, {stage}"] = to_nanotesla(tensor_rms_T_per_m(fields, _BASELINE_M))
    table = table_of(fitted)
    table[_ANGLES] = np.round(to_degrees(np.round(from_degrees(table[_ANGLES]), _RADIANS)), _DEGREES)
    turned = SensorErrors.from_matrix(case.errors.matrix.mean(axis=0)[None], np.zeros((1, 3)))
    seen = aligned_angles(artificial, case.field_T)
    return {
        **draws,
        "Table 3": table,
        "Table 3, PMEA": 100 * (1 - np.abs(table / PRESET - 1).max(axis=1)),
        _FRAME: to_degrees(seen),
        right_name(_FRAME): to_degrees(turned.misalignment),
        **_measured(experiment(seed)[0]),
        _REPRODUCTION: _reproduction_percent(),
        right_name(_REPRODUCTION): _reproduction_percent(),
    }


def stages(case: SetUp, fitted: SensorErrors) -> dict[str, FloatArray]:
    """Return the fields (N, 4, 3) before calibration and after that of each method, by the names of Tables 1 and 2.

    The tables show that the paper aligned the methods that it compares itself with by regression on the first turn.
    """
    own = {"Zhang": first_order_fields(case.recording)[:, :4], "Yin": orthogonal_fields(case.recording)[:, :4]}
    first = {name: aligned_by_regression(each, case.field_T, slice(0, _TURNS)) for name, each in own.items()}
    raw = case.recording.readings_T
    return {"before": raw, **first, "theirs": fitted.restore(raw)}


def _fitted_to(case: SetUp, reference_T: FloatArray) -> SensorErrors:
    """Return the twelve parameters of each sensor fitted to a reference (N, 3)."""
    readings = case.recording.readings_T / case.intensity_T
    rows = np.concatenate([readings, np.ones((*readings.shape[:2], 1))], axis=2)
    square = np.einsum("nki,nkj->kij", rows, rows)
    cross = np.einsum("nki,nj->kij", rows, reference_T / case.intensity_T)
    unmix, bias = regress(square, cross)
    return SensorErrors.from_matrix(np.linalg.inv(unmix), case.intensity_T * bias)


def artificial_field(case: SetUp) -> FloatArray:
    """Return the artificial vector (N, 3) of section 3.3: the mean reading, made orthogonal by its ellipsoid, tesla."""
    return orthogonal_fields(case.recording)[:, -1]


def aligned_angles(fields_T: FloatArray, reference_T: FloatArray) -> FloatArray:
    """Return the angles (3,) α, β, γ by which fields (N, 3) are turned from a reference (N, 3), radians."""
    left, _, right = np.linalg.svd(fields_T.T @ reference_T)
    return np.asarray(SensorErrors.from_matrix((left @ right)[None], np.zeros((1, 3))).misalignment[0])


def _measured(case: SetUp) -> Draws:
    """Return Tables 4 and 5 and the platform's residual; TMI is compared with that of the artificial platform."""
    fields, platform = calibrated(case)
    draws = {"Section 5, TMI of the artificial platform": _platform_nT(platform)}
    for stage, values in fields.items():
        draws[f"Table 4, TMI, {stage}"] = to_nanotesla(intensity_rms_T(values, norm(platform, axis=1)))
        draws[f"Table 5, {stage}"] = to_nanotesla(tensor_rms_T_per_m(values, case.baseline_m))
    return draws


def _platform_nT(platform_T: FloatArray) -> FloatArray:
    return to_nanotesla(intensity_rms_T(platform_T[:, None], _EXPERIMENT_T))


def calibrated(case: SetUp) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the fields (N, 4, 3) of the experiment by each method, and the artificial platform (N, 3)."""
    orthogonal = orthogonal_fields(case.recording)
    platform = orthogonal[:, -1]
    raw = case.recording.readings_T
    fields = {
        "before": raw,
        "Zhang": aligned_by_regression(first_order_fields(case.recording)[:, :4], platform),
        "Yin": aligned_by_regression(orthogonal[:, :4], platform),
        "theirs": _fitted_to(case, platform).restore(raw),
    }
    return fields, platform


def _reproduction_percent() -> FloatArray:
    """Return the least reproduction degree of a parameter in the two data sets of Table 6."""
    first, again = (np.array(_PRINTED[name]) for name in ("experiment", "experiment_again"))
    return np.array([100 * (1 - np.abs(again / first - 1).max())])
