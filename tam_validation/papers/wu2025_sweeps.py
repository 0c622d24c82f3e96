"""The sweeps of Wu 2025 section 4.1 over σ_VM, σ_SM and N, Figs. 4 to 9, with the fits of this package beside his."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.information import bound
from tam_calibration.fit.lossless import lossless
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import measure_residuals
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_nanotesla
from tam_calibration.simulation import Scenario, Simulation, simulate
from tam_calibration.simulation.instruments import ScalarReference
from tam_calibration.simulation.sources import SinusoidDrift
from tam_validation.papers.sweep import Figures, SweepPlan

PUBLISHED, CORRECTED, BEST = "lossless, as published", "lossless, step 1 corrected", "maximum likelihood"
_METHODS: dict[str, Callable[[Recording, Array], Calibration]] = {
    PUBLISHED: partial(lossless, as_published=True),
    CORRECTED: lossless,
    BEST: maximum_likelihood,
}
BEFORE, FLOOR, BOUND = "before", "noise floor", "Cramér–Rao bound"
IN_SAMPLE, HELD_OUT = "in sample", "held out"
RELATIVE_ERROR, ERROR = "relative error", "error"
GROUPS = {
    "scale factor errors": slice(0, 12),
    "non-orthogonality": slice(12, 24),
    "bias": slice(24, 36),
    "misalignment": slice(36, 45),
}
"""Columns of the 45 parameters that a uniform field determines."""

_VECTOR_NOISE_NT = (0.1, 0.2, 0.5, 1, 2, 5, 10)
_SCALAR_NOISE_NT = (0.01, 0.03, 0.1, 0.3, 1, 3, 10)
_SAMPLES = (60, 90, 180, 360, 720, 1440, 2880)
_DRIFT_NT = 8.26
_SWINGS = 3


def plans(table_1: Scenario) -> dict[str, SweepPlan]:
    """Return the sweeps; the scalar magnetometer is silent where the paper gives it the intensity of the site."""
    silent = _with_noise(table_1, scalar_nT=0.0)
    once = replace(table_1, scalar=ScalarReference(one_error_per_recording=True))
    swing = SinusoidDrift(from_nanotesla(_DRIFT_NT), table_1.sample_count / table_1.rate_hz / _SWINGS)
    by_vector = [_with_noise(silent, vector_nT=noise) for noise in _VECTOR_NOISE_NT]
    by_one_draw = [_with_noise(once, scalar_nT=noise) for noise in _SCALAR_NOISE_NT]
    by_many_draws = [_with_noise(table_1, scalar_nT=noise) for noise in _SCALAR_NOISE_NT]
    by_count = [replace(silent, sample_count=count) for count in _SAMPLES]
    return {
        "vector": SweepPlan("noise of the sensors", "σ_VM", "nT", _VECTOR_NOISE_NT, by_vector),
        "scalar": SweepPlan("scalar noise, one draw per data set", "σ_SM", "nT", _SCALAR_NOISE_NT, by_one_draw),
        "scalar per sample": SweepPlan(
            "scalar noise, one draw per sample", "σ_SM", "nT", _SCALAR_NOISE_NT, by_many_draws
        ),
        "samples": SweepPlan("number of samples", "N", "", _SAMPLES, by_count),
        "drift": SweepPlan(
            "drift of the field", "drift", "nT", (0, _DRIFT_NT), [table_1, replace(table_1, drift=swing)]
        ),
    }


def score(scenario: Scenario, number: int) -> Figures:
    """Return the figures of one simulated calibration.

    Parameters
    ----------
    scenario : Scenario
        What is simulated, once for the fit and once to be held out.
    number : int
        Of the run: it makes the random numbers.

    Returns
    -------
    mapping
        By (source, quantity). Of each method the 45 errors, SI, and relative to the true scale factor errors, angles
        and biases; of each method, of the raw readings and of the true parameters e_B of the sensors (Wu 2025 eqs. 14
        and 15, against the true intensity, tesla) and e_T (eqs. 16 and 17, T/m) of the data fitted and of as many held
        out; and of the bound the mean relative error of an efficient estimate.
    """
    seen, unseen = (simulate(replace(scenario, seed=2 * number + half)) for half in (0, 1))
    truth = _parameters(seen.errors)
    scale = np.abs(truth - np.repeat([1.0, 0.0], [12, 33]))
    smallest = bound(seen.center_field_T, seen.errors, scenario.array.with_stated_noise(), has_scalar=True)
    deviation = np.sqrt(_determined(np.diag(smallest).reshape(-1, 12)))
    # The mean of |x| of a Gaussian x is √(2/π) standard deviations.
    figures = {(BOUND, RELATIVE_ERROR): np.sqrt(2 / np.pi) * deviation / scale}
    candidates = {BEFORE: SensorErrors.none(scenario.array.sensor_count), FLOOR: scenario.errors}
    for name, fit in _METHODS.items():
        candidates[name] = fit(seen.recording, scenario.array).errors
        error = _parameters(candidates[name]) - truth
        figures |= {(name, ERROR): error, (name, RELATIVE_ERROR): np.abs(error) / scale}
    for name, errors in candidates.items():
        for data, simulation in ((IN_SAMPLE, seen), (HELD_OUT, unseen)):
            figures[name, f"e_B {data}"], figures[name, f"e_T {data}"] = _residuals(errors, simulation)
    return figures


def _with_noise(scenario: Scenario, vector_nT: float | None = None, scalar_nT: float | None = None) -> Scenario:
    array = scenario.array
    if vector_nT is not None:
        array = replace(array, vector_noise_T=np.full(array.sensor_count, from_nanotesla(vector_nT)))
    if scalar_nT is not None:
        array = replace(array, scalar_noise_T=from_nanotesla(scalar_nT))
    return replace(scenario, array=array)


def _parameters(errors: SensorErrors) -> FloatArray:
    return _determined(errors.to_vector())


def _determined(table: FloatArray) -> FloatArray:
    """Return the (12 K - 3,) values of a table (K, 12) by kind, without the misalignment of sensor 1."""
    kinds: FloatArray = table.reshape(len(table), 4, 3).transpose(1, 0, 2).ravel()
    return np.delete(kinds, np.s_[9 * len(table) : 9 * len(table) + 3])


def _residuals(errors: SensorErrors, simulation: Simulation) -> tuple[FloatArray, float]:
    true_intensity = norm(simulation.center_field_T, axis=1)
    recording = replace(simulation.recording, scalar_T=true_intensity)
    residuals = measure_residuals(errors, simulation.scenario.array, recording, float(true_intensity.mean()))
    return residuals.sensor_intensity_T, residuals.tensor_rmse_T_per_m
