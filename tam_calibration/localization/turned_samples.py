"""The dipole of each sample where the attitude is not exact: the regional field is then known but for a turn.

An error of the attitude of 0.1° turns 87 nT of 50 µT across the field, more than most sources make. What is left is the
intensity and the gradient, six numbers for six unknowns: nearly, these have several solutions. So the fit begins from
several turns. Where two different dipoles explain a sample as well, it is refused as ambiguous.

A turn moves the regional field f to another of the same length, g: what the dipole leaves of the reading. About g the
covariance is σ² (|g|² - g gᵀ), and along g the reading less f has |f| - fᵀg/|g| beside the dipole. The field of the
dipole itself is not turned: its place and moment are sought in the axes of the array.
"""

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution
from tam_calibration.localization.euler import locate
from tam_calibration.localization.finite_baseline import fit_dipoles
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.model.array import Array
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field

_TURNS = np.array([[0, 0], [1.5, 0], [-1.5, 0], [0, 1.5], [0, -1.5]])
"""Errors of the attitude about the two directions across the field from which fits begin, in units of their size."""

_LEAST_FIELD = 5.0
"""Field of a dipole over what an error of the attitude turns: below, the turn is guessed, and its dipole with it."""

_ROUNDS = 3
"""Fits of each, after the first with the turned field that the fit before leaves."""

_FARTHEST_M = 1e4
"""Beyond, what a fit has run away to is no place."""

_LARGEST_TURN = 0.5
"""Radians: no error of the attitude is as large, and what a wild fit leaves of the field was not made by one."""

_MOST_UNCERTAIN = 0.2
"""Standard error of a place over its distance: beyond, intervals of first order no longer hold what they say."""

_AS_GOOD = 9.0
"""χ² by which another dipole may be worse and still explain the sample: three standard deviations."""


def across_field(covariance: FloatArray, own: FloatArray, direction: FloatArray, attitude_noise: float) -> FloatArray:
    """Return covariances (N, 9, 9) of outputs less a regional field that is known but for a turn.

    Parameters
    ----------
    covariance : (9, 9) array
        Of the outputs.
    own : (N, 3, 3) array
        Of the regional field in the array frame, T².
    direction : (N, 3) array
        Field that is turned, array frame, tesla: an error of the attitude goes across it.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    """
    along = direction[:, :, None] * direction[:, None, :]
    size = np.einsum("ni,ni->n", direction, direction)[:, None, None]
    widened = np.repeat(covariance[None], len(direction), axis=0)
    widened[:, :3, :3] += own + attitude_noise**2 * (size * np.eye(3) - along)
    return widened


def locate_turned(
    outputs: FloatArray,
    field_T: FloatArray,
    array: Array,
    covariance: FloatArray,
    own: FloatArray,
    attitude_noise: float,
) -> EulerSolutions:
    """Locate the dipole of each sample beside a field that is known but for a turn.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    field_T : (N, 3) array
        The regional field as the reported attitude has it in the array frame, tesla.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) array
        Of the outputs.
    own : (N, 3, 3) array
        Of the regional field in the array frame, T².
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.

    Returns
    -------
    EulerSolutions
        With the reason of each sample that was not located.
    """
    source = np.concatenate([outputs[:, :3] - field_T, outputs[:, 3:]], axis=1)
    euler = locate(source, across_field(covariance, own, field_T, attitude_noise))
    result = EulerSolutions.refused(len(outputs), Status.UNCERTAIN)
    result.status[:] = euler.status
    at = np.flatnonzero(euler.is_located)
    if not len(at):
        return result
    solution = _fit(outputs[at], field_T[at], array, covariance, own[at], attitude_noise)
    shape = (len(_TURNS), len(at))
    is_settled = _is_near(solution)
    chi_square = np.where(is_settled, solution.chi_square, np.inf).reshape(shape)
    best = np.argmin(chi_square, axis=0)
    rows = np.arange(len(at))
    unknowns = np.where(is_settled[:, None], solution.unknowns, 1.0).reshape(*shape, 6)
    spread = solution.covariance.reshape(*shape, 6, 6)[best, rows]
    found = unknowns[best, rows]
    variance = np.trace(spread[:, :3, :3], axis1=1, axis2=2)
    apart = unknowns[..., :3] - found[:, :3]
    is_other = np.sum(apart**2, axis=2) > _AS_GOOD * variance
    is_as_good = chi_square < chi_square[best, rows] + _AS_GOOD
    field = norm(dipole_field(-found[:, :3], found[:, 3:])[0], axis=1)
    is_strong = field > _LEAST_FIELD * attitude_noise * norm(field_T[at], axis=1)
    is_sure = variance <= _MOST_UNCERTAIN**2 * np.sum(found[:, :3] ** 2, axis=1)
    status = np.where((is_other & is_as_good).any(axis=0), Status.AMBIGUOUS, Status.LOCATED)
    status = np.where(np.isfinite(chi_square[best, rows]) & is_sure, status, Status.UNCERTAIN)
    status = np.where((status == Status.LOCATED) & ~is_strong, Status.NO_FIELD, status)
    result.status[at] = status
    located, kept = at[status == Status.LOCATED], status == Status.LOCATED
    result.position_m[located], result.moment_Am2[located] = found[kept, :3], found[kept, 3:]
    result.position_covariance_m2[located] = spread[kept, :3, :3]
    result.moment_covariance_A2m4[located] = spread[kept, 3:, 3:]
    return result


def _fit(
    outputs: FloatArray,
    field_T: FloatArray,
    array: Array,
    covariance: FloatArray,
    own: FloatArray,
    attitude_noise: float,
) -> Solution:
    """Return the dipoles that are found from the source's field as it would be after each turn, one turn after another.

    All fits are made side by side.
    """
    across = np.linalg.svd(field_T[:, None])[2][:, 1:]
    size = attitude_noise * norm(field_T, axis=1)
    shifts = (size[:, None] * np.einsum("ta,nai->tni", _TURNS, across)).reshape(-1, 3)
    outputs, field_T, own = (np.tile(each, (len(_TURNS), *[1] * (each.ndim - 1))) for each in (outputs, field_T, own))
    source = np.concatenate([outputs[:, :3] - field_T, outputs[:, 3:]], axis=1)
    begin = locate(np.concatenate([source[:, :3] - shifts, source[:, 3:]], axis=1))
    start = np.nan_to_num(np.concatenate([begin.position_m, begin.moment_Am2], axis=1), nan=1.0)
    left = field_T
    for _ in range(_ROUNDS):
        seen = source[:, :8].copy()
        seen[:, :3] -= _longer(left, field_T)
        noise = across_field(covariance, own, left, attitude_noise)[:, :8, :8]
        solution = fit_dipoles(seen, array, noise, start)
        start = np.where(_is_near(solution)[:, None], solution.unknowns, start)
        left = outputs[:, :3] - dipole_field(-start[:, :3], start[:, 3:])[0]
        is_turn = norm(left - field_T, axis=1) < _LARGEST_TURN * norm(field_T, axis=1)
        left = np.where(is_turn[:, None], left, field_T)
    return solution


def _is_near(solution: Solution) -> np.ndarray:
    """Return which fits settled somewhere."""
    near: np.ndarray = solution.is_found & (np.abs(solution.unknowns[:, :3]).max(axis=1) < _FARTHEST_M)
    return near


def _longer(turned: FloatArray, field_T: FloatArray) -> FloatArray:
    """Return by how much fields (N, 3) are longer along what they are turned to than their part along it."""
    unit = turned / norm(turned, axis=1, keepdims=True)
    longer: FloatArray = unit * (norm(field_T, axis=1) - np.einsum("ni,ni->n", unit, field_T))[:, None]
    return longer
