"""The dipole of each sample where the attitude is not exact: the regional field is then known but for a turn.

An error of the attitude of 0.1° turns 87 nT of 50 µT across the field, more than most sources make. What is left is the
intensity and the gradient, six numbers for six unknowns: nearly, these have several solutions. So the fit begins from
several turns. Where two different dipoles explain a sample as well, it is refused as ambiguous.

A turn moves a field f across itself, with the covariance σ² (|f|² - f fᵀ), and shortens it along f by δ²/2|f|, δ being
how far it is moved. Both are taken at the field that is expected of a dipole, and again after each fit.
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

_TURNS = np.array([(x, y) for x in (-3, -1.5, 0, 1.5, 3) for y in (-3, -1.5, 0, 1.5, 3)])
"""Errors of the attitude about the two directions across the field from which fits begin, in units of their size."""

_VALLEY = 150.0
"""What an error of the attitude turns, over the noise of the field: beyond, χ² is so narrow a valley, and so bent, that
steps do not come along; fits begin with a noise that is larger for that, and go on with its root and with its own."""

_FARTHEST_M = 1e4
"""Beyond, what a fit has run away to is no place."""

_LARGEST_TURN = 0.5
"""Radians: a dipole that would need a larger error of the attitude is none, and its field no direction to turn."""

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
    euler = locate(source, across_field(covariance, own, outputs[:, :3], attitude_noise))
    result = EulerSolutions.refused(len(outputs), Status.UNCERTAIN)
    result.status[:] = euler.status
    at = np.flatnonzero(euler.is_located)
    if not len(at):
        return result
    solution = _fit(outputs[at], field_T[at], array, covariance, own[at], attitude_noise)
    shape = (len(_TURNS), len(at))
    is_settled = solution.is_found & (np.abs(solution.unknowns[:, :3]).max(axis=1) < _FARTHEST_M)
    chi_square = np.where(is_settled, solution.chi_square, np.inf).reshape(shape)
    best = np.argmin(chi_square, axis=0)
    rows = np.arange(len(at))
    unknowns = np.where(is_settled[:, None], solution.unknowns, 0.0).reshape(*shape, 6)
    spread = solution.covariance.reshape(*shape, 6, 6)[best, rows]
    found = unknowns[best, rows]
    variance = np.trace(spread[:, :3, :3], axis1=1, axis2=2)
    apart = unknowns[..., :3] - found[:, :3]
    is_other = np.sum(apart**2, axis=2) > _AS_GOOD * variance
    is_as_good = chi_square < chi_square[best, rows] + _AS_GOOD
    is_sure = variance <= _MOST_UNCERTAIN**2 * np.sum(found[:, :3] ** 2, axis=1)
    status = np.where((is_other & is_as_good).any(axis=0), Status.AMBIGUOUS, Status.LOCATED)
    status = np.where(np.isfinite(chi_square[best, rows]) & is_sure, status, Status.UNCERTAIN)
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
    across = np.linalg.svd(outputs[:, None, :3])[2][:, 1:]
    size = attitude_noise * norm(outputs[:, :3], axis=1)
    shifts = (size[:, None] * np.einsum("ta,nai->tni", _TURNS, across)).reshape(-1, 3)
    outputs, field_T, own = (np.tile(each, (len(_TURNS), *[1] * (each.ndim - 1))) for each in (outputs, field_T, own))
    source = np.concatenate([outputs[:, :3] - field_T, outputs[:, 3:]], axis=1)
    begin = locate(np.concatenate([source[:, :3] - shifts, source[:, 3:]], axis=1))
    start = np.nan_to_num(np.concatenate([begin.position_m, begin.moment_Am2], axis=1), nan=1.0)
    expected, widest = outputs[:, :3], max(float(np.median(size)) / (_VALLEY * np.sqrt(covariance[0, 0])), 1.0)
    for wider in (widest, widest**0.5, 1.0, 1.0):
        noise = across_field(wider**2 * covariance, own, expected, attitude_noise)[:, :8, :8]
        turned = source[:, :8].copy()
        turned[:, :3] += _shortening(outputs[:, :3], expected)
        solution = fit_dipoles(turned, array, noise, start)
        is_near = solution.is_found & (np.abs(solution.unknowns[:, :3]).max(axis=1) < _FARTHEST_M)
        start = np.where(is_near[:, None], solution.unknowns, start)
        field = field_T + dipole_field(-start[:, :3], start[:, 3:])[0]
        is_turn = norm(field - outputs[:, :3], axis=1) < _LARGEST_TURN * norm(outputs[:, :3], axis=1)
        expected = np.where(is_turn[:, None], field, outputs[:, :3])
    return solution


def _shortening(measured: FloatArray, expected: FloatArray) -> FloatArray:
    """Return by how much fields (N, 3) are shorter along the expected ones because they are turned away from them."""
    across = np.sum((measured - expected) ** 2, axis=1) / (2 * np.sum(expected**2, axis=1))
    shortening: FloatArray = expected * across[:, None]
    return shortening
