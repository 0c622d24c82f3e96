"""The simulation of Li 2018b: 12³ poses in 60 000 nT, Tables 1 to 4.

What reproduces the printed numbers: poses Rz Ry Rx with the turn about z fastest, misalignment by the inverse of eq. 6,
and noise of 1 nT on each axis of each sensor before the distortion. The ten samples of one turn that the paper names
determine no calibration; ours is from all poses. What is measured is in the file of what it prints.
"""

from typing import Any

import numpy as np

from tam_calibration.fit.moments import procrustes
from tam_calibration.fit.published import count_determined, fast_rotation, simplified_linear
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.cross import COMPONENTS, SENSORS, SetUp, grid_of_turns, observed, site_field
from tam_validation.papers.printed import finding, printed_in
from tam_validation.papers.row import PaperNumber, compare

_TURNS = 12
_BASELINE_M = 0.4
_NOISE_T = from_nanotesla(1.0)

_PRINTED = printed_in("li2018b")
PRESET = np.array(_PRINTED["preset"])
"""Rows ``_PARAMETERS`` of Table 1, columns the four sensors."""
_PARAMETERS = ("φ", "θ", "ψ", "c_x", "c_y", "c_z", "i_x", "i_y", "i_z")
_UNITS = ("°",) * 3 + ("1",) * 3 + ("nT",) * 3
_TOLERANCES = (5e-4,) * 3 + (1e-5,) * 3 + (0.3,) * 3
"""Absolute; four times the sampling error, or more."""

BEFORE, FIRST_ORDER, CALIBRATED, ALIGNED = "before", "method of [9]", "calibrated", "aligned by 3 samples"

_BY_ONE_TURN = 3 * 9 + 5
"""Parameters that one turn about one axis determines.

The field runs along a circle. There three of the four columns (b, 1) are independent, so 9 of the 12 parameters of each
other sensor, and five of the nine monomials of an ellipsoid.
"""


def set_up(seed: int = 0) -> SetUp:
    """Return the cross of Tables 1 and 3 and its readings."""
    site = site_field(from_nanotesla(60_000.0), 57.0, -5.0)
    grid = grid_of_turns("ZYX", _TURNS, site).reshape(_TURNS, _TURNS, _TURNS, 3)
    field = grid.transpose(2, 1, 0, 3).reshape(-1, 3)
    return observed(_true_errors(), field, _BASELINE_M, _NOISE_T, seed)


def _true_errors() -> SensorErrors:
    """Return the preset errors; the paper's θ is our φ, its φ our θ, and its rotation is from the sensor."""
    angles = from_degrees(PRESET[:3].T)
    zero = np.zeros((4, 3))
    from_sensor = SensorErrors(zero + 1, zero, zero, from_degrees(np.array(_PRINTED["misalignment_deg"]))).rotation
    measurement = SensorErrors(PRESET[3:6].T, angles, zero, zero).measurement
    return SensorErrors.from_matrix(measurement @ np.swapaxes(from_sensor, 1, 2), from_nanotesla(PRESET[6:].T))


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
    return observed(case.errors, field, _BASELINE_M, _NOISE_T, seed)


def results() -> list[PaperNumber]:
    """Return the numbers of Tables 1 to 4 and what the abstract says of one turn, the paper's beside ours."""
    case = set_up()
    fields = stages(case)
    return [
        *_parameter_rows(fast_rotation(case.recording, case.array).errors),
        *_intensity_rows(case, fields),
        *_misalignment_rows(case, fields[CALIBRATED]),
        *_tensor_rows(case, fields),
        *_rank_rows(),
    ]


def stages(case: SetUp) -> dict[str, FloatArray]:
    """Return the fields (N, 4, 3) before calibration and after each step of it, by the names of Tables 2 and 4."""
    raw = case.recording.readings_T
    errors = fast_rotation(case.recording, case.array).errors
    zero = np.zeros((4, 3))
    own = SensorErrors(errors.scale_factor, errors.non_orthogonality, errors.bias_T, zero).restore(raw)
    return {
        BEFORE: raw,
        FIRST_ORDER: simplified_linear(case.recording, case.array).errors.restore(raw),
        CALIBRATED: own,
        ALIGNED: np.einsum("kji,nkj->nki", _rotations(case, own, 3), own),
    }


def _rotations(case: SetUp, own_fields_T: FloatArray, samples: int) -> FloatArray:
    """Return the rotations (4, 3, 3) from the platform to calibrated sensors, from samples of the first turn."""
    chosen = slice(0, _TURNS, _TURNS // samples)
    return procrustes(np.einsum("nki,nj->kij", own_fields_T[chosen], case.field_T[chosen]))


def _parameter_rows(errors: SensorErrors) -> list[PaperNumber]:
    columns = [to_degrees(errors.non_orthogonality), errors.scale_factor, to_nanotesla(errors.bias_T)]
    rows = []
    ours_by_name = np.concatenate(columns, axis=1).T
    for name, unit, tolerance, printed, ours, preset in zip(
        _PARAMETERS, _UNITS, _TOLERANCES, _PRINTED["estimated"], ours_by_name, PRESET, strict=True
    ):
        names = [f"Table 1, {name}, {sensor}" for sensor in SENSORS]
        stated: dict[str, Any] = {
            "names": names,
            "paper": printed,
            "unit": unit,
            "right": preset,
            "absolute": tolerance,
        }
        rows += finding("li2018b", "parameters", ours, **stated)
    return rows


def _intensity_rows(case: SetUp, fields: dict[str, FloatArray]) -> list[PaperNumber]:
    stages = (fields[stage] for stage in (BEFORE, FIRST_ORDER, CALIBRATED))
    before, simplified, calibrated = (to_nanotesla(case.intensity_rms_T(stage)) for stage in stages)
    ours = {BEFORE: before, FIRST_ORDER: simplified, "method of [10]": simplified, "theirs": calibrated}
    rows = []
    for stage, values in ours.items():
        names = [f"Table 2, TMI, {stage}, {sensor}" for sensor in SENSORS]
        rows += finding("li2018b", f"TMI, {stage}", values, names=names, paper=_PRINTED["table_2"][stage])
    return rows


def _misalignment_rows(case: SetUp, own: FloatArray) -> list[PaperNumber]:
    rows = []
    for samples in (3, 12):
        from_sensor = np.swapaxes(_rotations(case, own, samples), 1, 2)
        angles = SensorErrors.from_matrix(from_sensor, np.zeros((4, 3))).misalignment
        for sensor, printed, ours in zip(SENSORS, _PRINTED[f"misalignment_from_{samples}"], angles, strict=True):
            names = [f"Table 3, {angle} from {samples} samples, {sensor}" for angle in "αβγ"]
            # The noise of three samples moves an angle by some 2e-5.
            rows += compare(names, printed, ours, "rad", absolute=1e-4)
    return rows


def _tensor_rows(case: SetUp, fields: dict[str, FloatArray]) -> list[PaperNumber]:
    rows = []
    for stage, printed in _PRINTED["table_4"].items():
        stated: dict[str, Any] = {
            "names": [f"Table 4, {component}, {stage}" for component in COMPONENTS],
            "paper": printed,
        }
        if stage == CALIBRATED:
            stated["right"] = np.array(printed) * 0.5 / _BASELINE_M
        ours = to_nanotesla(case.tensor_rms_T_per_m(fields[stage]))
        rows += finding("li2018b", f"tensor, {stage}", ours, **stated)
    return rows


def _rank_rows() -> list[PaperNumber]:
    case = turns_about("z")
    determined, every = count_determined(case.recording, case.array)
    stated: dict[str, Any] = {"paper": [every], "right": [_BY_ONE_TURN], "told": {"left": every - _BY_ONE_TURN}}
    return finding("li2018b", "one_turn", [determined], **stated)
