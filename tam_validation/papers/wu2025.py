"""Wu 2025: the simulations of section 4.1 and the measured numbers of section 4.2.

Of its curves section 4.1 says in words what they do, and prints no value: straight growth is an exponent of 1, no
change one of 0, "slightly increases" the sign +1.
"""

from dataclasses import replace

import numpy as np

from tam_calibration.model.units import FloatArray, to_degrees
from tam_validation.papers import wu2025_experiment
from tam_validation.papers.row import Draws
from tam_validation.papers.wu2025_sweeps import SWEEPS, Point, run_point

_HORIZONTAL_NT, _VERTICAL_NT = 25_560.0, 48_650.0
_THRESHOLD_SAMPLES = 720
"""From where on more samples are looked at for what they still bring."""
_OUTGROWN_NT = 3.0
"""Scalar noise from which on 1 nT of the sensors hardly counts."""

_TURNED = "Section 4.1, relative errors, {} over random rotation"
_ONE, _MANY = "one draw per data set", "one draw per sample"


def simulate(seed: int, as_published: bool) -> Draws:
    """Return what one study of 50 runs a point gives, by the findings of the paper, and the curves of its figures.

    Parameters
    ----------
    seed : int
        Of all random numbers.
    as_published : bool
        Whether step 1 takes the intensity as constant also where it drifts, as eq. 12 does, and not as the scalar
        magnetometer reads it.
    """
    sweeps = {
        name: [run_point(setting, seed, as_published or not setting.drifts) for setting in sweep.settings]
        for name, sweep in SWEEPS.items()
    }
    vector, one, _, samples, drift, turns = sweeps.values()
    without, drifting = drift
    random, *turned = turns
    relative = {name: np.array([point.relative for point in points]) for name, points in sweeps.items()}
    by_vector, by_one, by_many, by_samples = list(relative.items())[:4]
    late = _exponents(*by_samples, _THRESHOLD_SAMPLES)
    return {
        "Section 4.1, intensity from H and Z": np.array([np.hypot(_HORIZONTAL_NT, _VERTICAL_NT)]),
        "Section 4.1, inclination from H and Z": to_degrees(np.arctan2([_VERTICAL_NT], [_HORIZONTAL_NT])),
        _TURNED.format("turns about three axes one by one"): turned[0].relative / random.relative,
        _TURNED.format("a grid of turns about three axes"): turned[1].relative / random.relative,
        "Fig. 5b, size of e_B after at σ_VM = 1 nT": vector[3].after[:4].mean(),
        "Fig. 9b, size of e_B after at N": np.array([point.after[:4].mean() for point in (samples[0], samples[-1])]),
        "Fig. 5d, size of e_T after at σ_VM = 1 nT": vector[3].after[4],
        "Fig. 7d, size of e_T after at σ_SM = 10 nT": one[-1].after[4],
        "Fig. 9d, size of e_T after at N = 2880": samples[-1].after[4],
        "Abstract, fluctuation of 8.26 nT tracked: RMSE of the biases over that without": np.array(
            [drifting.bias_rmse_T / without.bias_rmse_T]
        ),
        "Fig. 4, growth with σ_VM": _exponents(*by_vector),
        "Fig. 4, fluctuation of the relative errors with σ_VM": _sign("noise of the sensors", vector, 0),
        **_residual_growth("Fig. 5, growth {} with σ_VM", "noise of the sensors", vector),
        f"Fig. 6, {_ONE}, growth with σ_SM": _exponents(*by_one, 1.0),
        **_residual_growth(f"Fig. 7, {_ONE}, growth {{}} with σ_SM", f"scalar noise, {_ONE}", _less_first(one), 0.03),
        f"Fig. 6, {_MANY}, growth with σ_SM": _exponents(*by_many, _OUTGROWN_NT),
        "Fig. 8, change with N": np.sign(_exponents(*by_samples)),
        "Fig. 8, growth with N from 720": late,
        **_residual_growth("Fig. 9, growth {} with N", "number of samples", samples),
        "Fig. 9, fluctuation of e_B before with N": _sign("number of samples", samples, 1),
        "Fig. 9, change after with N": np.sign(_residual_exponents("number of samples", samples, "after")),
        **wu2025_experiment.simulate(seed),
        **{name: _curve(points) for name, points in sweeps.items()},
    }


def _exponents(sweep: str, curves: FloatArray, least: float = 0.0) -> FloatArray:
    """Return the exponents (n,) with which curves (P, n) change with the setting, from some setting on."""
    points = np.array(SWEEPS[sweep].points)
    chosen = points >= least
    return np.asarray(np.polyfit(np.log(points[chosen]), np.log(curves[chosen]), 1)[0])


def _residual_exponents(sweep: str, points: list[Point], stage: str, least: float = 0.0) -> FloatArray:
    """Return the exponents (2,) of e_B, the mean of the sensors, and of e_T."""
    residuals = np.array([getattr(point, stage) for point in points])
    return _exponents(sweep, np.stack([residuals[:, :4].mean(axis=1), residuals[:, 4]], axis=1), least)


def _residual_growth(name: str, sweep: str, points: list[Point], least: float = 0.0) -> Draws:
    return {name.format(stage): _residual_exponents(sweep, points, stage, least) for stage in ("before", "after")}


def _less_first(points: list[Point]) -> list[Point]:
    """Return points whose e_B after calibration is what it has over the first point's, in quadrature."""
    first = points[0].after[:4]
    return [
        replace(each, after=np.append(np.sqrt(np.abs(each.after[:4] ** 2 - first**2)), each.after[4]))
        for each in points
    ]


def _sign(sweep: str, points: list[Point], which: int) -> FloatArray:
    """Return whether a scatter over the runs grows with the setting, +1 or -1."""
    return np.sign(_exponents(sweep, np.array([[point.scatter[which]] for point in points])))


def _curve(points: list[Point]) -> FloatArray:
    """Return the relative errors and the residuals before and after (P, 14) for the figures."""
    return np.array([np.concatenate([point.relative, point.before, point.after]) for point in points])
