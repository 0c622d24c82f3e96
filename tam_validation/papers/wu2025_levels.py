"""What the printed set-up of Wu 2025 section 4.1 implies: the site, and how large e_B and e_T are after calibration.

The figures themselves are pictures. Their curves after calibration follow from the noise σ, the number N of samples and
the baseline d: a fit of nine parameters leaves √(1 - 9/N) of the noise of an intensity, and a tensor of five components
has 3 σ/d. Those before it hang on how the attitudes are distributed, which the paper does not print.
"""

import numpy as np

from tam_calibration.model.units import from_nanotesla, to_degrees, to_nanotesla
from tam_validation.papers.row import DERIVED, PaperNumber, compare, correct_paper
from tam_validation.papers.sweep import Sweep
from tam_validation.papers.wu2025_sweeps import IN_SAMPLE, PUBLISHED

_INTENSITY_NT, _HORIZONTAL_NT, _VERTICAL_NT, _INCLINATION_DEG = 54955.83, 25_560.0, 48_650.0, 62 + 18 / 60
_NOISE_T = from_nanotesla(1.0)
_BASELINE_M = 0.5
_ELLIPSOID = 9
"""Parameters that are fitted to the intensities of a sensor."""
_TOLERANCE = 0.01
"""Relative; three times the scatter over 50 runs of 360 samples, and what the alignment takes of e_T (0.4 %)."""


def rows(sweeps: dict[str, Sweep], slack: float) -> list[PaperNumber]:
    """Return the site, and the sizes of e_B and e_T after calibration that the set-up implies beside the sweeps'.

    Parameters
    ----------
    sweeps : dict
        Those of Wu 2025 by name.
    slack : float
        By how much tolerances are wider than those for 50 runs.
    """
    return [*_site_rows(), *_after_rows(sweeps, slack)]


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
            right_source=DERIVED,
            absolute=0.5 / 60,
        ),
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
    return compare(
        [f"{name} after at {where}"],
        [to_nanotesla(implied)],
        [to_nanotesla(float(ours))],
        unit,
        relative=_TOLERANCE * slack,
        reason="the sweep does not have what N, the noise and the baseline imply",
        source=DERIVED,
    )
