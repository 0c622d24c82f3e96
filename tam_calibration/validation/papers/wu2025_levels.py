"""What the printed set-up of Wu 2025 section 4.1 implies: the site, and how large e_B and e_T of Figs. 5, 7 and 9 are.

The figures themselves are pictures. Their curves before calibration follow from Table 1 by a mean over all directions
of the field; those after it from the noise σ, the number N of samples and the baseline d: a fit of nine parameters
leaves √(1 - 9/N) of the noise of an intensity, and a tensor of five components has 3 σ/d.
"""

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import measure_residuals
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_nanotesla, to_degrees, to_nanotesla
from tam_calibration.simulation import Scenario
from tam_calibration.validation.papers.cross import SENSORS
from tam_calibration.validation.papers.row import PaperNumber, compare, correct_paper
from tam_calibration.validation.papers.sweep import Sweep
from tam_calibration.validation.papers.wu2025_coil import directions
from tam_calibration.validation.papers.wu2025_sweeps import BEFORE, IN_SAMPLE, PUBLISHED

_INTENSITY_NT, _HORIZONTAL_NT, _VERTICAL_NT, _INCLINATION_DEG = 54955.83, 25_560.0, 48_650.0, 62 + 18 / 60
_NOISE_T = from_nanotesla(1.0)
_BASELINE_M = 0.5
_ELLIPSOID = 9
"""Parameters that are fitted to the intensities of a sensor."""
_BEFORE_TOLERANCE = 0.01
"""Relative; three times the scatter of the mean over 50 runs of 2880 random attitudes, or more."""
_AFTER_TOLERANCE = 0.01
"""Relative; three times the scatter over 50 runs of 360 samples, and what the alignment takes of e_T (0.4 %)."""


def rows(sweeps: dict[str, Sweep], slack: float) -> list[PaperNumber]:
    """Return the site, and the sizes of e_B and e_T that the set-up implies beside those of the sweeps.

    Parameters
    ----------
    sweeps : dict
        Those of Wu 2025 by name.
    slack : float
        By how much tolerances are wider than those for 50 runs.
    """
    return [*_site_rows(), *_before_rows(sweeps["samples"], slack), *_after_rows(sweeps, slack)]


def _site_rows() -> list[PaperNumber]:
    ours = np.hypot(_HORIZONTAL_NT, _VERTICAL_NT)
    inclination = to_degrees(np.arctan2(_VERTICAL_NT, _HORIZONTAL_NT))
    reason = "the printed H and Z give 62°17′, rounding included"
    return [
        # H and Z are printed to 10 nT.
        *compare(["Section 4.1, intensity from H and Z"], [_INTENSITY_NT], [ours], "nT", absolute=5),
        *correct_paper(
            ["Section 4.1, inclination from H and Z"],
            [_INCLINATION_DEG],
            [inclination],
            "°",
            reason,
            right=[62 + 17 / 60],
            right_source="derived from printed numbers",
            absolute=0.5 / 60,
        ),
    ]


def implied_before(scenario: Scenario) -> tuple[FloatArray, float]:
    """Return e_B (4,) and e_T of raw readings, root mean squares over all directions of the field, tesla and T/m.

    Parameters
    ----------
    scenario : Scenario
        With errors and site.
    """
    half = directions(2000)
    field = norm(scenario.site_field_T) * np.concatenate([half, -half])
    intensity = norm(field, axis=1)
    readings = scenario.errors.distort(np.repeat(field[:, None], len(SENSORS), axis=1))
    recording = Recording(np.arange(len(field), dtype=float), readings, intensity)
    none = SensorErrors.none(len(SENSORS))
    residuals = measure_residuals(none, scenario.array, recording, float(intensity.mean()))
    return residuals.sensor_intensity_T, residuals.tensor_rmse_T_per_m


def _before_rows(sweep: Sweep, slack: float) -> list[PaperNumber]:
    of_intensity, of_tensor = implied_before(sweep.plan.scenarios[-1])
    e_B, e_T = (sweep.mean(BEFORE, f"{quantity} {IN_SAMPLE}")[-1] for quantity in ("e_B", "e_T"))
    names = [f"Figs. 5a, 7a and 9a, size of e_B before, {sensor}" for sensor in SENSORS]
    return [
        *_compare(names, of_intensity, e_B, "nT", _BEFORE_TOLERANCE * slack),
        *_compare(["Figs. 5c, 7c and 9c, size of e_T before"], [of_tensor], e_T, "nT/m", _BEFORE_TOLERANCE * slack),
    ]


def _after_rows(sweeps: dict[str, Sweep], slack: float) -> list[PaperNumber]:
    tensor_floor = 3 * _NOISE_T / _BASELINE_M
    table = []
    for figure, name, setting in (("5b", "vector", 1.0), ("9b", "samples", 60), ("9b", "samples", 2880)):
        count = setting if name == "samples" else 360
        implied = _NOISE_T * np.sqrt(1 - _ELLIPSOID / count)
        table += _after(f"Fig. {figure}, size of e_B", sweeps[name], setting, "e_B", implied, "nT", slack)
    for figure, name, setting in (("5d", "vector", 1.0), ("7d", "scalar", 10.0), ("9d", "samples", 2880)):
        table += _after(f"Fig. {figure}, size of e_T", sweeps[name], setting, "e_T", tensor_floor, "nT/m", slack)
    return table


def _after(
    name: str, sweep: Sweep, setting: float, quantity: str, implied: float, unit: str, slack: float
) -> list[PaperNumber]:
    at = sweep.plan.points.index(setting)
    ours = sweep.mean(PUBLISHED, f"{quantity} {IN_SAMPLE}")[at].mean()
    where = f"{sweep.plan.symbol} = {setting:g} {sweep.plan.unit}".strip()
    return _compare([f"{name} after at {where}"], [implied], [ours], unit, _AFTER_TOLERANCE * slack)


def _compare(
    names: list[str], implied: FloatArray | list[float], ours: FloatArray | list[float], unit: str, relative: float
) -> list[PaperNumber]:
    reason = "the sweep does not have what Table 1, N and the noise imply"
    return compare(
        names,
        to_nanotesla(np.asarray(implied)).tolist(),
        to_nanotesla(np.asarray(ours)),
        unit,
        relative=relative,
        reason=reason,
        source="derived from printed numbers",
    )
