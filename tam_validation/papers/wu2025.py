"""Wu 2025: the simulations of section 4.1 and the measured numbers of section 4.2.

Of its curves section 4.1 says in words what they do, and prints no value: straight growth is an exponent of 1, no
change one of 0, "slightly increases" the sign +1. What is compared with nothing is in the file of what it prints.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from tam_calibration.model.units import FloatArray, from_nanotesla, to_degrees, to_nanotesla
from tam_calibration.simulation import Scenario
from tam_validation.papers import wu2025_experiment
from tam_validation.papers.printed import finding
from tam_validation.papers.row import IN_WORDS, PaperNumber, compare
from tam_validation.papers.sweep import Progress, Sweep, run
from tam_validation.papers.wu2025_sweeps import (
    BEFORE,
    CORRECTED,
    ERROR,
    FLOOR,
    GROUPS,
    HELD_OUT,
    IN_SAMPLE,
    PUBLISHED,
    RELATIVE_ERROR,
    plans,
    score,
)

_RUNS = 50
_THRESHOLD_SAMPLES = 720
"""From where on more samples are looked at for what they still bring."""
_HIGH_SCALAR_NOISE_NT = 1.0
_OUTGROWN_NT = 3.0  # scalar noise beside which 1 nT of the sensors hardly counts


def results(
    table_1: Scenario, turntable: Scenario, runs: int = _RUNS, progress: Progress = lambda done, total: None
) -> tuple[list[PaperNumber], dict[str, Sweep]]:
    """Return the numbers of the paper that a simulation gives beside ours, and the sweeps that its figures show.

    Parameters
    ----------
    table_1, turntable : Scenario
        Section 4.1 with the errors of Table 1, and section 4.2 with those of Table 2.
    runs : int
        Monte Carlo runs of each point of a sweep.
    progress : callable
        Called with the number of runs that are done, and of all.
    """
    planned = plans(table_1)
    sweeps = dict(zip(planned, run(list(planned.values()), score, runs, progress), strict=True))
    return [*simulated_rows(sweeps), *wu2025_experiment.rows(turntable)], sweeps


def simulated_rows(sweeps: dict[str, Sweep]) -> list[PaperNumber]:
    """Return the numbers and trends of section 4.1."""
    return [
        *implied_rows(sweeps, _slack(sweeps["samples"])),
        *_drift_rows(sweeps["drift"]),
        *_vector_noise_rows(sweeps["vector"]),
        *_scalar_noise_rows(sweeps["scalar"]),
        *_scalar_noise_per_sample_rows(sweeps["scalar per sample"]),
        *_sample_rows(sweeps["samples"]),
    ]


def excess(sweep: Sweep, quantity: str) -> float:
    """Return k of (quantity/floor)² = 1 + k/N for the published method in the sweep over N.

    Parameters
    ----------
    sweep : Sweep
        Over the number N of samples.
    quantity : str
        Residual of the fitted or the held-out data, such as "e_B in sample".
    """
    after, floor = (np.mean(sweep.values[source, quantity] ** 2, axis=(1, 2)) for source in (PUBLISHED, FLOOR))
    return float(np.mean((after / floor - 1) * sweep.points))


def bias_rmse(sweep: Sweep, source: str) -> FloatArray:
    """Return the root mean square errors of the biases at the P points of a sweep.

    Parameters
    ----------
    sweep : Sweep
        With the errors of the method.
    source : str
        The method.

    Returns
    -------
    (P,) array
        Over all runs, sensors and axes, tesla.
    """
    error = sweep.values[source, ERROR][:, :, GROUPS["bias"]]
    return np.asarray(np.sqrt(np.mean(error**2, axis=(1, 2))))


def _drift_rows(sweep: Sweep) -> list[PaperNumber]:
    (without, drifting), corrected = bias_rmse(sweep, PUBLISHED), bias_rmse(sweep, CORRECTED)
    told = {"ratio": corrected[1] / corrected[0]}
    return finding("wu2025", "drift", [drifting / without], slack=_slack(sweep), told=told)


def _vector_noise_rows(sweep: Sweep) -> list[PaperNumber]:
    scatter = sweep.values[PUBLISHED, RELATIVE_ERROR].mean(axis=2).std(axis=1)
    threshold = "in proportion to σ_VM at every level: 1 nT is no threshold"
    return [
        *_error_rows(sweep, "Fig. 4", dict.fromkeys(GROUPS, 1)),
        *_sign_rows("Fig. 4, fluctuation of the relative errors", 1, sweep.exponent(scatter), threshold),
        *_residual_rows(sweep, "Fig. 5", {"e_B": 1, "e_T": 1}),
    ]


def _scalar_noise_rows(sweep: Sweep) -> list[PaperNumber]:
    none = dict.fromkeys(GROUPS, 0) | {"scale factor errors": 1}
    return [
        *_error_rows(sweep, "Fig. 6, one draw per data set", none, _HIGH_SCALAR_NOISE_NT),
        *_residual_rows(sweep, "Fig. 7, one draw per data set", {"e_B": 1, "e_T": 0}, _OUTGROWN_NT),
    ]


def _scalar_noise_per_sample_rows(sweep: Sweep) -> list[PaperNumber]:
    figure = "Fig. 6, one draw per sample"
    reproduced = {"scale factor errors": 1, "bias": 0, "misalignment": 0}
    moving = _group_exponent(sweep, "non-orthogonality", _OUTGROWN_NT)
    return [*_error_rows(sweep, figure, reproduced, _OUTGROWN_NT), *finding("wu2025", "moving", [moving])]


def _sample_rows(sweep: Sweep) -> list[PaperNumber]:
    scatter = sweep.values[BEFORE, f"e_B {IN_SAMPLE}"].mean(axis=2).std(axis=1)
    falling = {group: _group_exponent(sweep, group) for group in GROUPS}
    late = [_group_exponent(sweep, group, _THRESHOLD_SAMPLES) for group in GROUPS]
    names = [f"Fig. 8, {group} with N from {_THRESHOLD_SAMPLES}" for group in GROUPS]
    rows = []
    for group, exponent in falling.items():
        rows += _sign_rows(f"Fig. 8, {group} with N", -1, exponent)
    rows += finding("wu2025", "late", late, slack=_slack(sweep), names=names)
    rows += _residual_rows(sweep, "Fig. 9", {})
    rows += _sign_rows("Fig. 9, fluctuation of e_B before with N", -1, sweep.exponent(scatter))
    for quantity, sign, cause in (("e_B", 1, "judged by the data of the fit, "), ("e_T", -1, "")):
        inside, outside = (excess(sweep, f"{quantity} {data}") for data in (IN_SAMPLE, HELD_OUT))
        note = f"{cause}floor √(1 {_signed(inside)}/N); on other data floor √(1 {_signed(outside)}/N)"
        rows += _sign_rows(f"Fig. 9, {quantity} after with N", sign, -inside, note)
    return rows


def _error_rows(sweep: Sweep, figure: str, exponents: dict[str, int], least: float = 0.0) -> list[PaperNumber]:
    names = [f"{figure}, {group} with {sweep.plan.symbol}" for group in exponents]
    ours = [_group_exponent(sweep, group, least) for group in exponents]
    return compare(names, list(exponents.values()), ours, "exponent", absolute=0.1, source=IN_WORDS)


def _group_exponent(sweep: Sweep, group: str, least: float = 0.0) -> float:
    return sweep.exponent(sweep.mean(PUBLISHED, RELATIVE_ERROR)[:, GROUPS[group]].mean(axis=1), least)


def _residual_rows(sweep: Sweep, figure: str, after: dict[str, int], least: float = 0.0) -> list[PaperNumber]:
    """Return the exponents of e_B and e_T before, which shall be zero, and after."""
    rows = []
    for source, stage, exponents in ((BEFORE, "before", {"e_B": 0, "e_T": 0}), (PUBLISHED, "after", after)):
        names = [f"{figure}, {quantity} {stage} with {sweep.plan.symbol}" for quantity in exponents]
        curves = [sweep.mean(source, f"{quantity} {IN_SAMPLE}").mean(axis=1) for quantity in exponents]
        ours = [sweep.exponent(curve, least) for curve in curves]
        tolerance = 0.1 * _slack(sweep) if least else 0.01
        rows += compare(names, list(exponents.values()), ours, "exponent", absolute=tolerance, source=IN_WORDS)
    return rows


def _sign_rows(name: str, said: int, slope: float, note: str = "") -> list[PaperNumber]:
    rows = compare([name], [said], [float(np.sign(slope))], "sign", source=IN_WORDS)
    return [replace(row, reason=note) for row in rows]


def _slack(sweep: Sweep) -> float:
    """Return by how much tolerances are wider than those for 50 runs, which are three sampling errors or more."""
    runs = sweep.values[PUBLISHED, ERROR].shape[1]
    return max(1.0, float(np.sqrt(_RUNS / runs)))


def _signed(value: float) -> str:
    return f"{'−' if value < 0 else '+'} {abs(value):.1f}"


_HORIZONTAL_NT, _VERTICAL_NT = 25_560.0, 48_650.0
_NOISE_T = from_nanotesla(1.0)
_BASELINE_M = 0.5
_ELLIPSOID = 9
"""Parameters that are fitted to the intensities of a sensor."""


def implied_rows(sweeps: dict[str, Sweep], slack: float) -> list[PaperNumber]:
    """Return the site, and the sizes of e_B and e_T after calibration that the set-up implies beside the sweeps'.

    The figures themselves are pictures. Their curves after calibration follow from the noise σ, the number N of samples
    and the baseline d: a fit of nine parameters leaves √(1 - 9/N) of the noise of an intensity, and a tensor of five
    components has 3 σ/d. Those before it hang on how the attitudes are distributed, which the paper does not print.

    Parameters
    ----------
    sweeps : dict
        Those of Wu 2025 by name.
    slack : float
        By how much tolerances are wider than those for 50 runs.
    """
    return [*_site_rows(), *_after_rows(sweeps, slack)]


def _site_rows() -> list[PaperNumber]:
    intensity = np.hypot(_HORIZONTAL_NT, _VERTICAL_NT)
    inclination = to_degrees(np.arctan2(_VERTICAL_NT, _HORIZONTAL_NT))
    printed, right = ([62 + minutes / 60] for minutes in (18, 17))
    return [
        *finding("wu2025", "intensity", [intensity]),
        *finding("wu2025", "inclination", [inclination], paper=printed, right=right, absolute=0.5 / 60),
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
    stated: dict[str, Any] = {"names": [f"{name} after at {where}"], "paper": [to_nanotesla(implied)], "unit": unit}
    return finding("wu2025", "sizes", [to_nanotesla(float(ours))], slack=slack, **stated)
