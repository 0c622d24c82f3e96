"""The Euler solution rid of its error from finite baselines.

The tensor of an array is a slope over its baselines, and what an array of length L reads r away from a dipole is not
the tensor at its centre: it differs by about (L/r)². The outputs, fitted with what the array makes of the fields at
its sensors, give the dipole without that error.
"""

from functools import partial

import numpy as np

from tam_calibration.localization.euler import DIPOLE_INDEX, locate
from tam_calibration.localization.line_fit import CURRENT_INDEX, DIPOLES_INDEX, directions_of, fit_lines
from tam_calibration.localization.solutions import EulerSolutions, Status, in_pieces
from tam_calibration.localization.source_problem import OutputFit, Problem, solve
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field

_MOST_UNCERTAIN = 0.2
"""Standard error of a place over its distance: beyond, intervals of first order no longer hold what they say."""


def locate_with_baselines(
    outputs: FloatArray, array: Array, covariance: FloatArray | None = None, *, index: float = DIPOLE_INDEX
) -> EulerSolutions:
    """Locate the source of each sample: the constrained Euler solution, then a fit with the array's true baselines.

    Parameters
    ----------
    outputs : (N, 9) or (N, 8) array
        Field and gradient of the source alone, in the order of ``array.OUTPUT_NAMES``, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) or (8, 8) or (N, …) array, optional
        Of the outputs. Without it they are weighted as by equal noise of all sensors.
    index : float
        Structural index: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current; of a line its nearest point is
        located.

    Returns
    -------
    EulerSolutions
        With the reason of each sample that was not located, which is that of the Euler solution.

    Raises
    ------
    InputError
        When a shape or the structural index is wrong, or the array has no gradient.
    """
    if not array.has_gradient:
        raise InputError("the array's geometry determines no gradient: locate with the direct fit to its readings")
    require_index(index)
    return in_pieces(partial(_locate, array, index), np.asarray(outputs, dtype=float), covariance)


def require_index(index: float) -> None:
    """Refuse a structural index of no source that is known.

    Parameters
    ----------
    index : float
        Structural index.

    Raises
    ------
    InputError
        When it is none of 1, 2 and 3.
    """
    if index not in (CURRENT_INDEX, DIPOLES_INDEX, DIPOLE_INDEX):
        raise InputError(
            "the structural index must be 3 of a dipole, 2 of a line of dipoles or 1 of a line of current, not "
            f"{index:g}"
        )


def _locate(array: Array, index: float, outputs: FloatArray, covariance: FloatArray | None) -> EulerSolutions:
    euler = locate(outputs, covariance, index=index)
    at = np.flatnonzero(euler.is_located)
    if not len(at):
        return euler
    operator = array.operator[:8]
    noise = operator @ operator.T if covariance is None else np.asarray(covariance, dtype=float)[..., :8, :8]
    if noise.ndim == 3:
        noise = noise[at]
    start = start_of(euler, outputs, index)[at]
    fit = fit_outputs(outputs[at, :8], array, noise, start, index)
    solution = fit.solution
    is_sure = solution.is_found & is_certain(solution.unknowns, solution.covariance, covariance is not None)
    status = euler.status.copy()
    status[at[~is_sure]] = Status.UNCERTAIN
    unknowns, spread, chi_square = (
        each[is_sure] for each in (solution.unknowns, solution.covariance, solution.chi_square)
    )
    if covariance is None:
        spread, chi_square = np.full_like(spread, np.nan), np.full_like(chi_square, np.nan)
    return EulerSolutions.of_fits(status, unknowns, spread, chi_square, index == DIPOLE_INDEX)


def is_certain(unknowns: FloatArray, covariance: FloatArray, is_known: bool = True) -> np.ndarray:
    """Return of which sources (N, 6) with covariances (N, 6, 6) the intervals of first order hold what they say.

    Where the noise is not known, those of all.
    """
    variance = np.trace(covariance[:, :3, :3], axis1=1, axis2=2)
    certain: np.ndarray = (variance <= _MOST_UNCERTAIN**2 * np.sum(unknowns[:, :3] ** 2, axis=1)) | (not is_known)
    return certain


def start_of(euler: EulerSolutions, outputs: FloatArray, index: float) -> FloatArray:
    """Return where fits begin (N, 6): Euler's places, and the moments of dipoles or vectors along lines."""
    vectors = euler.moment_Am2 if index == DIPOLE_INDEX else directions_of(outputs)
    return np.concatenate([euler.position_m, vectors], axis=1)


def fit_outputs(
    outputs: FloatArray, array: Array, noise: FloatArray, start: FloatArray, index: float = DIPOLE_INDEX
) -> OutputFit:
    """Return the sources that fit the outputs of an array with its true baselines, each sample a problem of its own.

    Parameters
    ----------
    outputs : (N, 8) array
        Field and gradient of the source alone, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    noise : (8, 8) or (N, 8, 8) array
        Covariance of the outputs, for all samples or each.
    start : (N, 6) array
        Places to begin with [m], and moments [A m²] or vectors along lines.
    index : float
        Structural index.

    Returns
    -------
    OutputFit
        Unknowns (N, 6) are places and moments, or nearest points of lines and unit vectors along them.

    Raises
    ------
    InputError
        When a covariance has no inverse.
    """
    points, by_points = elements_of(array)
    whitening = whitening_of(noise)
    weights: FloatArray = whitening @ by_points
    data = (whitening @ outputs[..., None])[..., 0]
    if index != DIPOLE_INDEX:
        return fit_lines(data, points, weights, start, index)
    problem = Problem(dipole_field, points[None], weights[..., None, :, :], np.zeros((1, 8, 0)))
    solution = solve(problem, data, start)
    with np.errstate(over="ignore", invalid="ignore"):
        field_T = dipole_field(-solution.unknowns[:, :3], solution.unknowns[:, 3:])[0]
        predicted, slopes = problem.predict(solution.unknowns)
    return OutputFit(solution, field_T, data - predicted, slopes)


def elements_of(array: Array) -> tuple[FloatArray, FloatArray]:
    """Return where the field is read (P, 3), metres, and the (8, 3 P) matrix from the fields there to the outputs."""
    operator = array.operator[:8]
    if array.axis_offsets_m is None:
        return array.positions_m, operator
    # Each axis reads its own component where its element sits.
    by_elements = np.einsum("oka,ab->okab", operator.reshape(8, -1, 3), np.eye(3))
    return array.element_positions_m.reshape(-1, 3), by_elements.reshape(8, -1)


def whitening_of(noise: FloatArray) -> FloatArray:
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
