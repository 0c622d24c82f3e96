"""The Euler solution rid of its error from finite baselines.

The tensor of an array is a slope over its baselines, and what an array of length L reads r away from a dipole is not
the tensor at its centre: it differs by about (L/r)². The outputs, fitted with what the array makes of the fields at
its sensors, give the dipole without that error.
"""

from functools import partial

import numpy as np

from tam_calibration.core.least_squares import Solution
from tam_calibration.localization.euler import locate
from tam_calibration.localization.solutions import EulerSolutions, Status, in_pieces
from tam_calibration.localization.source_problem import Problem, solve
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field


def locate_dipole(outputs: FloatArray, array: Array, covariance: FloatArray | None = None) -> EulerSolutions:
    """Locate the dipole of each sample: the constrained Euler solution, then a fit with the array's true baselines.

    Parameters
    ----------
    outputs : (N, 9) or (N, 8) array
        Field and gradient of the dipole alone, in the order of ``array.OUTPUT_NAMES``, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) or (8, 8) or (N, …) array, optional
        Of the outputs. Without it they are weighted as by equal noise of all sensors.

    Returns
    -------
    EulerSolutions
        With the reason of each sample that was not located, which is that of the Euler solution.

    Raises
    ------
    InputError
        When a shape is wrong, or the array has no gradient.
    """
    if not array.has_gradient:
        raise InputError("the array's geometry determines no gradient: locate with the direct fit to its readings")
    return in_pieces(partial(_locate_dipole, array), np.asarray(outputs, dtype=float), covariance)


def _locate_dipole(array: Array, outputs: FloatArray, covariance: FloatArray | None) -> EulerSolutions:
    euler = locate(outputs, covariance)
    at = np.flatnonzero(euler.is_located)
    if not len(at):
        return euler
    operator = array.operator[:8]
    noise = operator @ operator.T if covariance is None else np.asarray(covariance, dtype=float)[..., :8, :8]
    if noise.ndim == 3:
        noise = noise[at]
    start = np.concatenate([euler.position_m[at], euler.moment_Am2[at]], axis=1)
    solution = fit_dipoles(outputs[at, :8], array, noise, start)
    found = at[solution.is_found]
    status = euler.status.copy()
    status[at[~solution.is_found]] = Status.UNCERTAIN
    unknowns, spread = np.full((len(outputs), 6), np.nan), np.full((len(outputs), 6, 6), np.nan)
    unknowns[found] = solution.unknowns[solution.is_found]
    if covariance is not None:
        spread[found] = solution.covariance[solution.is_found]
    return EulerSolutions(unknowns[:, :3], spread[:, :3, :3], unknowns[:, 3:], spread[:, 3:, 3:], status)


def fit_dipoles(outputs: FloatArray, array: Array, noise: FloatArray, start: FloatArray) -> Solution:
    """Return the dipoles that fit the outputs of an array with its true baselines, each sample a problem of its own.

    Parameters
    ----------
    outputs : (N, 8) array
        Field and gradient of the dipole alone, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    noise : (8, 8) or (N, 8, 8) array
        Covariance of the outputs, for all samples or each.
    start : (N, 6) array
        Places and moments to begin with, metres and A m².

    Raises
    ------
    InputError
        When a covariance has no inverse.
    """
    points, by_points = _elements(array)
    whitening = _whitening(noise)
    weights = (whitening @ by_points)[..., None, :, :]
    data = (whitening @ outputs[..., None])[..., 0]
    return solve(Problem(dipole_field, points[None], weights, np.zeros((1, 8, 0))), data, start)


def _elements(array: Array) -> tuple[FloatArray, FloatArray]:
    """Return where the field is read (P, 3), and the (8, 3 P) matrix from the fields there to the outputs."""
    operator = array.operator[:8]
    if array.axis_offsets_m is None:
        return array.positions_m, operator
    # Each axis reads its own component where its element sits.
    by_elements = np.einsum("oka,ab->okab", operator.reshape(8, -1, 3), np.eye(3))
    return array.element_positions_m.reshape(-1, 3), by_elements.reshape(8, -1)


def _whitening(noise: FloatArray) -> FloatArray:
    """Return a square root (…, 8, 8) of the inverse of covariances (…, 8, 8) of field and gradient.

    Raises
    ------
    InputError
        When one has no inverse.
    """
    scale = np.sqrt(np.diagonal(noise, axis1=-2, axis2=-1))
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise InputError("the covariance of field and gradient must have a positive, finite diagonal")
    values, vectors = np.linalg.eigh(noise / scale[..., :, None] / scale[..., None, :])
    if values.min() <= 0:
        raise InputError("the covariance of field and gradient is singular or not a covariance")
    root: FloatArray = np.swapaxes(vectors, -1, -2) / np.sqrt(values)[..., None] / scale[..., None, :]
    return root
