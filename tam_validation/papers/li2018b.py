"""Li 2018b: the simulation of 12³ poses in 60 000 nT, Tables 1 to 4, and the experiment, Tables 5 to 7.

What reproduces the printed numbers: poses Rz Ry Rx with the turn about z fastest, misalignment by the inverse of eq. 6,
and noise of 1 nT on each axis of each sensor before the distortion. The ten samples of one turn that the paper names
determine no calibration; ours is from all poses.
"""

import numpy as np

from tam_calibration.core.noise import complete_noise
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import procrustes
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.cross import (
    SetUp,
    aligned,
    grid_of_turns,
    intensity_rms_T,
    observed,
    site_field,
    tensor_rms_T_per_m,
)
from tam_validation.papers.ellipsoids import first_order_fields, orthogonal_fields, own_errors, with_mean
from tam_validation.papers.field_experiment import field_experiment, poses
from tam_validation.papers.printed import printed_in
from tam_validation.papers.row import Draws, right_name

_TURNS = 12
_BASELINE_M = 0.4
NOISE_T = from_nanotesla(1.0)
"""Of the simulation, as the paper states it."""

_ONE_TURN = slice(0, 10)
"""The samples from which the paper calibrates."""
_EXPERIMENT_T = from_nanotesla(53_907.16)
_RANDOM_POSES = 36

_PRINTED = printed_in("li2018b")
PRESET = np.array(_PRINTED["preset"])
"""Rows φ, θ, ψ, c_x, c_y, c_z, i_x, i_y, i_z of Table 1, columns the four sensors."""
_MISALIGNMENT = from_degrees(np.array(_PRINTED["misalignment_deg"]))
_EXPERIMENT, _AGAIN = (np.array(_PRINTED[name]) for name in ("experiment", "experiment_again"))

BEFORE, FIRST_ORDER, CALIBRATED, ALIGNED = "before", "method of [9]", "calibrated", "aligned by 3 samples"
_OTHER, _THEIRS, _PMER = "method of [10]", "theirs", "Table 7, PMER"


def set_up(seed: int = 0) -> SetUp:
    """Return the cross of Tables 1 and 3 and its readings."""
    site = site_field(from_nanotesla(60_000.0), 57.0, -5.0)
    grid = grid_of_turns("ZYX", _TURNS, site).reshape(_TURNS, _TURNS, _TURNS, 3)
    field = grid.transpose(2, 1, 0, 3).reshape(-1, 3)
    return observed(_errors_of(PRESET, _MISALIGNMENT), field, _BASELINE_M, NOISE_T, seed)


def experiment(seed: int, noise_T: float = NOISE_T) -> tuple[SetUp, FloatArray]:
    """Return the cross of section 5.2 with the errors of Table 7, and its poses."""
    to_world = poses(_RANDOM_POSES, np.random.default_rng([seed, 0]))
    errors = _errors_of(_EXPERIMENT[:9], from_degrees(_EXPERIMENT[9:].T))
    return field_experiment(errors, _EXPERIMENT_T, 0.0, to_world, noise_T, seed), to_world


def _errors_of(table: FloatArray, misalignment: FloatArray) -> SensorErrors:
    """Return the errors of a table (9, 4) and angles (4, 3); θ is our φ, φ our θ, the rotation is from the sensor."""
    zero = np.zeros((4, 3))
    from_sensor = SensorErrors(zero + 1, zero, zero, misalignment).rotation
    measurement = SensorErrors(table[3:6].T, from_degrees(table[:3].T), zero, zero).measurement
    return SensorErrors.from_matrix(measurement @ np.swapaxes(from_sensor, 1, 2), from_nanotesla(table[6:].T))


def turns_about(axes: str, seed: int = 0) -> SetUp:
    """Return the same cross turned once about each of some axes, 36 samples a turn.

    Parameters
    ----------
    axes : str
        Axes of the turns one after the other, such as "z" or "zxy".
    seed : int
        Of the noise.
    """
    from scipy.spatial.transform import Rotation

    case = set_up(seed)
    steps = 2 * np.pi * np.arange(36)[:, None] / 36
    field = np.concatenate([Rotation.from_euler(axis, steps).apply(case.field_T[0]) for axis in axes])
    return observed(case.errors, field, _BASELINE_M, NOISE_T, seed)


def simulate(seed: int, as_published: bool) -> Draws:
    """Return what one simulation gives, by the findings of the paper.

    Parameters
    ----------
    seed : int
        Of noise and poses.
    as_published : bool
        Whether sensors are calibrated from ten samples of one turn, as the paper says, and not from all 1728. These
        determine no ellipsoid: what hangs on it is NaN.
    """
    case = set_up(seed)
    raw = case.recording.readings_T
    errors = _calibrated(case.recording.take(_ONE_TURN) if as_published else case.recording)
    own = np.full_like(raw, np.nan) if errors is None else errors.restore(raw)
    simplified = to_nanotesla(intensity_rms_T(first_order_fields(case.recording)[:, :4], case.intensity_T))
    turn = turns_about("z", seed)
    table = np.full_like(PRESET, np.nan) if errors is None else _table_of(errors)
    draws = {
        "Table 1": table,
        "Table 1, PMED": 100 * np.abs(table / PRESET - 1).max(axis=1),
        "Abstract, parameters that ten samples of one turn determine of a sensor": _rank_of_ellipsoid(case),
        "Abstract, parameters that one turn determines": count_determined(turn.recording, turn.array)[0],
        f"Table 2, TMI, {BEFORE}": to_nanotesla(intensity_rms_T(raw, case.intensity_T)),
        f"Table 2, TMI, {FIRST_ORDER}": simplified,
        f"Table 2, TMI, {_OTHER}": simplified,
        f"Table 2, TMI, {_THEIRS}": to_nanotesla(intensity_rms_T(own, case.intensity_T)),
    }
    for samples in (3, 12):
        angles = _angles(case, own, samples)
        draws[f"Table 3, from {samples} samples"] = angles
        draws[f"Table 3, PMED from {samples} samples"] = 100 * np.abs(angles / _MISALIGNMENT - 1).max(axis=1)
    third = slice(0, _TURNS, _TURNS // 3)
    turned = own if errors is None else aligned(own, case.field_T, third)
    for stage, fields in {BEFORE: raw, CALIBRATED: own, ALIGNED: turned}.items():
        draws[f"Table 4, {stage}"] = to_nanotesla(tensor_rms_T_per_m(fields, _BASELINE_M))
    degree = 100 * (1 - np.abs(_AGAIN / _EXPERIMENT - 1).max(axis=1))
    return {**draws, **_measured(experiment(seed)[0]), _PMER: degree, right_name(_PMER): degree}


def _calibrated(recording: Recording) -> SensorErrors | None:
    try:
        return own_errors(recording)
    except InputError:
        return None


def _table_of(errors: SensorErrors) -> FloatArray:
    columns = [to_degrees(errors.non_orthogonality), errors.scale_factor, to_nanotesla(errors.bias_T)]
    return np.concatenate(columns, axis=1).T


def _angles(case: SetUp, own_T: FloatArray, samples: int) -> FloatArray:
    """Return the angles (4, 3) from calibrated sensors to the platform, from samples of the first turn, radians."""
    if np.isnan(own_T).any():
        return np.full((4, 3), np.nan)
    chosen = slice(0, _TURNS, _TURNS // samples)
    rotation = procrustes(np.einsum("nki,nj->kij", own_T[chosen], case.field_T[chosen]))
    return SensorErrors.from_matrix(np.swapaxes(rotation, 1, 2), np.zeros((4, 3))).misalignment


def _rank_of_ellipsoid(case: SetUp) -> int:
    """Return how many of the nine monomials of an ellipsoid are independent over the samples of one turn."""
    points = case.field_T[_ONE_TURN].T / case.intensity_T
    monomials = ellipsoid.monomial_columns(points, np.ones(points.shape[1]))[:9]
    return int(np.linalg.matrix_rank(monomials, tol=1e-9))


def _measured(case: SetUp) -> Draws:
    """Return Tables 5 and 6, calibrated and aligned from all poses."""
    raw = with_mean(case.recording.readings_T)
    simplified, own = first_order_fields(case.recording), orthogonal_fields(case.recording)
    stages = {BEFORE: raw, FIRST_ORDER: simplified, _OTHER: simplified, _THEIRS: own}
    draws = {
        f"Table 5, TMI, {stage}": to_nanotesla(intensity_rms_T(fields, _EXPERIMENT_T))
        for stage, fields in stages.items()
    }
    tensors = {BEFORE: raw, CALIBRATED: own, **{f"aligned by {count} samples": turned(own, count) for count in (36, 3)}}
    for stage, fields in tensors.items():
        components = to_nanotesla(tensor_rms_T_per_m(fields, case.baseline_m))
        draws[f"Table 6, {stage}"] = components[:5] if "aligned" in stage else components
    return draws


def turned(own_T: FloatArray, samples: int) -> FloatArray:
    """Return the orthogonal fields (N, 5, 3) turned onto the platform's by some samples of the turn about z."""
    return aligned(own_T, own_T[:, -1], slice(0, 36, 36 // samples))


def count_determined(recording: Recording, array: Array) -> tuple[int, int]:
    """Return how many parameters the directions of a recording determine, and how many there are.

    The rank of the Jacobian: the differences between sensors see each row of [D Λ | o] along (b, 1), the intensity sees
    the nine parameters of an ellipsoid along the monomials of the readings. What rises above the noise is counted.

    Parameters
    ----------
    recording : Recording
        Raw readings; the directions are those of sensor 1 about the mean of its readings.
    array : Array
        Noise of the K sensors; it is estimated where it is not stated.

    Returns
    -------
    int, int
        How many are determined, and 12 K - 3 in all, less one without a scalar reference.
    """
    noisy, _ = complete_noise(array, recording)
    centered = recording.readings_T[:, 0] - recording.readings_T[:, 0].mean(axis=0)
    radius = np.sqrt(np.mean(np.sum(centered**2, axis=1)))
    points = centered / radius
    # Times the noise that a direction must be turned through to count: less would let noise determine a
    # parameter.
    # Least turn that counts without noise, of the field: least squares lose as much to rounding.
    least = max(10.0 * float(noisy.vector_noise_T[0]) / radius, 1e-9) * np.sqrt(len(points))
    linear = _rank(np.column_stack([points, np.ones(len(points))]), least)
    quadratic = min(_rank(ellipsoid.monomial_columns(points.T, np.ones(len(points)))[:10].T, least), 9)
    scale = 1 if recording.scalar_T is None else 0
    others = recording.sensor_count - 1
    return 3 * others * linear + quadratic - scale, 12 * others + 9 - scale


def _rank(rows: FloatArray, least: float) -> int:
    return int(np.sum(np.linalg.svd(rows, compute_uv=False) > least))
