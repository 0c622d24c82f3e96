"""Residuals of every sample by errors that were fitted without it."""

from dataclasses import replace

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.consistency import Fit
from tam_calibration.fit.gauss_newton import newton_step
from tam_calibration.fit.identifiability import FEWEST_SAMPLES
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.fit.recorded_attitude import as_if_uniform
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.residuals import Residuals, measure_residuals

_FOLDS, _BLOCKS_PER_FOLD = 5, 10
"""A fifth of the samples is held out at once, in blocks of time so short that no fold lacks an attitude."""


def held_out_residuals(
    recording: SampleSource, array: Array, fit: Fit, calibration: Calibration, known: Known | None
) -> Residuals | None:
    """Return the residuals of every sample, each corrected by the other folds of blocks of time.

    Parameters
    ----------
    recording : SampleSource
        Raw readings.
    array : Array
        As it was given to the fit.
    fit : callable
        The method.
    calibration : Calibration
        Of all samples.
    known : Known, optional
        What a maximum likelihood fit knows in addition. Without its part of the normal equations, one Gauss-Newton
        step then leads from the calibration to the fit of the other folds. By default these are fitted anew.

    Returns
    -------
    Residuals or None
        None if the recording is too short, or the other folds make no calibration.
    """
    fold_of = _folds(recording.sample_count)
    sizes = np.bincount(fold_of, minlength=_FOLDS)
    if not sizes.all() or recording.sample_count - sizes.max() < 2 * FEWEST_SAMPLES:
        return None
    held_out = [recording.take(fold_of == fold) for fold in range(_FOLDS)]
    try:
        if known is not None:
            return _pool(_by_steps(held_out, array, calibration, known), sizes)
        return _pool(
            [_by_fit(recording.take(fold_of != fold), held_out[fold], array, fit) for fold in range(_FOLDS)], sizes
        )
    except (InputError, Refused):
        return None


def _folds(count: int) -> np.ndarray:
    """Return the number of the fold (N,) of each sample."""
    block = np.arange(_FOLDS * _BLOCKS_PER_FOLD)
    starts = -(-np.append(block, len(block)) * count // len(block))
    return np.repeat((block % _FOLDS).astype(np.int8), np.diff(starts))


def _by_fit(others: SampleSource, samples: SampleSource, array: Array, fit: Fit) -> Residuals:
    fitted = fit(others, array)
    seen = as_if_uniform(samples, fitted.errors, array, fitted.ambient_gradient)
    return measure_residuals(fitted.errors, array, seen, fitted.intensity_T)


def _by_steps(folds: list[SampleSource], array: Array, calibration: Calibration, known: Known) -> list[Residuals]:
    place = Place(calibration.errors, calibration.intensity_T)
    used, has_scalar = replace(known, start=place), any(fold.scalar_count is not None for fold in folds)
    problems = [Problem.of(fold, calibration.array, used, has_scalar) for fold in folds]
    parts = [problem.data_at(place) for problem in problems]
    whole, basis = sum(parts, problems[0].known_at(place)), problems[0].basis_at(place)
    found = []
    for problem, fold, own in zip(problems, folds, parts, strict=True):
        others = (whole - own).by(basis)
        step = newton_step(others.information, others.score)
        moved = problem.moved(place, basis @ step)
        found.append(measure_residuals(moved.errors, array, fold, moved.intensity_T))
    return found


def _pool(parts: list[Residuals], sizes: np.ndarray) -> Residuals:
    weight = sizes / sizes.sum()
    sensors = np.array([part.sensor_intensity_T for part in parts])
    center = np.array([part.center_intensity_T for part in parts])
    tensor = np.array([part.tensor_T_per_m for part in parts])
    return Residuals(np.sqrt(weight @ sensors**2), float(np.sqrt(weight @ center**2)), np.sqrt(weight @ tensor**2))
