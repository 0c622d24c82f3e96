"""Euler localisation: a source's position from the field and the gradient tensor that it makes in one place.

A field that falls with the n-th power of the distance fulfils Euler's equation G r = -n B, with r from the source to
the array. n is the structural index: 3 for a dipole, 2 for a line of dipoles, 1 for a line of current. The constrained
solution takes r in the plane across the eigenvector of smallest |eigenvalue|, to which a dipole's r is at right angles
(Wu 2025 section 3.2): r = -n Σ (vₖᵀB/λₖ) vₖ over the other two. Without a trace these two cannot be small, so the
constrained solution needs no regularisation, where the unconstrained G⁻¹ breaks down as the moment turns across r.

The tensor of an array is a slope over its baselines, and what an array of length L reads r away from a dipole is not
the tensor at its centre: it differs by about (L/r)². The outputs, fitted with what the array makes of the fields at
its sensors, give the dipole without that error.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from tam_calibration.localization.line_fit import CURRENT_INDEX, DIPOLES_INDEX, directions_of, fit_lines
from tam_calibration.localization.solutions import EulerSolutions, Status, in_pieces
from tam_calibration.localization.source_problem import OutputFit, Problem, solve
from tam_calibration.model.array import UNIT_TENSORS, Array, tensors_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field, moment_of_field

DIPOLE_INDEX = 3.0

# 99.73 % points of χ² with 3 and 5 degrees of freedom: as rare as three standard deviations.
_FIELD_CHI_SQUARE, _TENSOR_CHI_SQUARE, _DEVIATIONS = 14.16, 18.21, 3.0
_ROUNDING = 1e-12


def locate(
    outputs: FloatArray,
    covariance: FloatArray | None = None,
    *,
    index: float = DIPOLE_INDEX,
    constrained: bool = True,
) -> EulerSolutions:
    """Locate the source of each sample; a sample's result does not depend on its neighbours.

    Parameters
    ----------
    outputs : (N, 9) or (N, 8) array
        Field and gradient of the source alone, in the order of ``array.OUTPUT_NAMES``, array frame, tesla and T/m;
        gzz is taken as -gxx - gyy.
    covariance : (9, 9) or (8, 8) or (N, …) array, optional
        Of the outputs, for all samples or each. Without it only exact degeneracy is seen; where it is not finite, as
        for an array without gradient, the sample is refused.
    index : float
        Structural index n: the field falls as 1/rⁿ.
    constrained : bool
        Whether r is kept at right angles to the eigenvector of smallest |eigenvalue|.

    Returns
    -------
    EulerSolutions
        With the reason of each sample that was not located.

    Raises
    ------
    InputError
        When a shape or the structural index is wrong, or the covariance is none.
    """
    outputs, _ = _check(outputs, covariance, index)
    return in_pieces(partial(_locate, index=index, constrained=constrained), outputs, covariance)


def _locate(outputs: FloatArray, covariance: FloatArray | None, index: float, constrained: bool) -> EulerSolutions:
    outputs, noise = _check(outputs, covariance, index)
    is_finite = np.asarray(np.isfinite(outputs).all(axis=1) & np.isfinite(noise).all(axis=(1, 2)))
    outputs, noise = (np.where(is_finite.reshape(-1, *[1] * (each.ndim - 1)), each, 0.0) for each in (outputs, noise))
    system = _System.of(outputs, noise, constrained)
    status = _degeneracies(system, outputs, noise, constrained)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        r, by_output = system.solve(index)
        covariance_of_r: FloatArray = by_output @ noise @ np.swapaxes(by_output, 1, 2)
        if constrained:
            covariance_of_r = _add_ambiguity(system, r, covariance_of_r, status, index)
        spread = np.trace(covariance_of_r, axis1=1, axis2=2)
        _mark(status, Status.UNCERTAIN, ~(spread <= np.sum(r**2, axis=1)))
        moment, by_r, by_field = moment_of_field(r, outputs[:, :3])
        by_output_of_moment = by_r @ by_output
        by_output_of_moment[..., :3] += by_field
        covariance_of_moment = by_output_of_moment @ noise @ np.swapaxes(by_output_of_moment, 1, 2)
    status[~is_finite] = Status.NOT_FINITE
    refused, is_dipole = status != Status.LOCATED, index == DIPOLE_INDEX
    unknown = refused if covariance is not None else np.full(len(r), True)
    return EulerSolutions(
        _blank(-r, refused),
        _blank(covariance_of_r, unknown),
        _blank(moment, refused | (not is_dipole)),
        _blank(covariance_of_moment, unknown | (not is_dipole)),
        status,
    )


@dataclass(frozen=True, eq=False)
class _System:
    """The tensors in their eigenvectors, |eigenvalues| falling, and the inverse that is taken of each."""

    field: FloatArray
    values: FloatArray
    vectors: FloatArray
    inverse: FloatArray
    by_output: FloatArray
    gap_deviation: FloatArray
    deviations: FloatArray

    @classmethod
    def of(cls, outputs: FloatArray, noise: FloatArray, constrained: bool) -> "_System":
        values, vectors = np.linalg.eigh(tensors_of(outputs))
        order = np.argsort(-np.abs(values), axis=1)
        values = np.take_along_axis(values, order, axis=1)
        vectors = np.take_along_axis(vectors, order[:, None], axis=2)
        with np.errstate(divide="ignore", over="ignore"):
            inverse = 1 / values
        if constrained:
            inverse[:, 2] = 0
        field = np.einsum("nik,ni->nk", vectors, outputs[:, :3])
        by_output = np.einsum("nik,oij,njl->nokl", vectors, UNIT_TENSORS, vectors, optimize=True)
        tensor_noise = noise[:, 3:8, 3:8]
        slopes = np.diagonal(by_output, axis1=2, axis2=3)
        deviations = np.sqrt(np.einsum("nok,nop,npk->nk", slopes, tensor_noise, slopes))
        difference = slopes[..., 1] - slopes[..., 2]
        gap = np.sqrt(np.einsum("no,nop,np->n", difference, tensor_noise, difference))
        return cls(field, values, vectors, inverse, by_output, gap, deviations)

    @property
    def is_gap_hidden(self) -> np.ndarray:
        """(N,) whether the two smaller eigenvalues are equal within noise and rounding."""
        gap = np.abs(self.values[:, 1] - self.values[:, 2])
        return gap <= _DEVIATIONS * self.gap_deviation + _ROUNDING * np.abs(self.values[:, 0])

    def solve(self, index: float) -> tuple[FloatArray, FloatArray]:
        """Return r (N, 3) and its derivatives (N, 3, 8) by the outputs.

        The inverse of the tensor is a function g of its eigenvalues, and its derivative in the eigenvectors is the
        difference quotient (g_i - g_j)/(λ_i - λ_j): -g_i g_j between those that are kept. Where it is chance which of
        two equal eigenvalues is left out, the derivative is that with neither left out.
        """
        inverse = np.where(self.is_gap_hidden[:, None], 1 / self.values, self.inverse)
        quotient = -inverse[:, :, None] * inverse[:, None, :]
        mixing = inverse[:, :2] / (self.values[:, :2] - self.values[:, 2:])
        is_left_out = inverse[:, 2] == 0
        quotient[is_left_out, :2, 2] = quotient[is_left_out, 2, :2] = mixing[is_left_out]
        by_tensor = np.einsum("nkl,nokl,nl->nko", quotient, self.by_output, self.field)
        by_field = inverse[:, :, None] * np.swapaxes(self.vectors, 1, 2)
        derivative = self.vectors @ np.concatenate([by_field, by_tensor], axis=2)
        return -index * np.einsum("nik,nk->ni", self.vectors, self.inverse * self.field), -index * derivative


def _check(outputs: FloatArray, covariance: FloatArray | None, index: float) -> tuple[FloatArray, FloatArray]:
    """Return the first eight outputs, and their covariance (N, 8, 8)."""
    outputs = np.asarray(outputs, dtype=float)
    if outputs.ndim != 2 or outputs.shape[1] not in (8, 9):
        raise InputError(
            f"outputs must be N rows of field and gradient, 8 or 9 numbers; their shape is {outputs.shape}"
        )
    if not (np.isfinite(index) and index > 0):
        raise InputError(f"the structural index must be a positive number, such as 3 for a dipole, not {index}")
    count = len(outputs)
    if covariance is None:
        return outputs[:, :8], np.zeros((count, 8, 8))
    covariance = np.asarray(covariance, dtype=float)
    if covariance.shape[-2:] not in ((8, 8), (9, 9)) or covariance.shape[:-2] not in ((), (count,)):
        raise InputError(
            f"the covariance must be (9, 9) or (8, 8), one for all or each of {count} samples, not {covariance.shape}"
        )
    covariance = covariance[..., :8, :8]
    if not is_covariance(covariance[np.isfinite(covariance).all(axis=(-2, -1))]):
        raise InputError("the covariance of field and gradient must be symmetric and positive definite")
    return outputs[:, :8], np.broadcast_to(covariance, (count, 8, 8))


def _degeneracies(system: _System, outputs: FloatArray, noise: FloatArray, constrained: bool) -> np.ndarray:
    status = np.full(len(outputs), Status.LOCATED, dtype=int)
    _mark(status, Status.NO_FIELD, _is_hidden(outputs[:, :3], noise[:, :3, :3], _FIELD_CHI_SQUARE))
    _mark(status, Status.NO_GRADIENT, _is_hidden(outputs[:, 3:], noise[:, 3:, 3:], _TENSOR_CHI_SQUARE))
    if not constrained:
        least = _DEVIATIONS * system.deviations[:, 2] + _ROUNDING * np.abs(system.values[:, 0])
        _mark(status, Status.ILL_CONDITIONED, np.abs(system.values[:, 2]) <= least)
    return status


def _is_hidden(values: FloatArray, noise: FloatArray, chi_square: float) -> np.ndarray:
    """Return whether values (N, D) with noise (N, D, D) are zero, or cannot be told from zero."""
    size = np.sum(values**2, axis=1)
    # In the metric of the noise |v|² ≤ χ² is v vᵀ ≤ χ² Σ; noise that is zero needs no inverse.
    largest = np.linalg.eigvalsh(chi_square * noise - values[:, :, None] * values[:, None, :])[:, 0]
    return np.asarray((size == 0) | (largest >= 0) & (np.trace(noise, axis1=1, axis2=2) > 0))


def _add_ambiguity(
    system: _System, r: FloatArray, covariance: FloatArray, status: np.ndarray, index: float
) -> FloatArray:
    """Add to the covariance what leaving out the other eigenvector would change, and mark where that is too much."""
    other = np.where([False, True, True], 1 / system.values, 0.0) * system.field * np.array([0, -1, 1])
    change = -index * np.einsum("nik,nk->ni", system.vectors, other)
    change[~system.is_gap_hidden] = 0
    size = np.sum(change**2, axis=1)
    least = _DEVIATIONS**2 * np.trace(covariance, axis1=1, axis2=2) + 1e-6 * np.sum(r**2, axis=1)
    _mark(status, Status.AMBIGUOUS, size > least)
    squared: FloatArray = change[:, :, None] * change[:, None, :]
    return covariance + squared


def _mark(status: np.ndarray, value: Status, where: np.ndarray) -> None:
    """Note a reason where none has been found before."""
    status[where & (status == Status.LOCATED)] = value


def _blank(values: FloatArray, where: np.ndarray) -> FloatArray:
    return np.where(where.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)


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
    return in_pieces(partial(_fitted, array, index), np.asarray(outputs, dtype=float), covariance)


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


def _fitted(array: Array, index: float, outputs: FloatArray, covariance: FloatArray | None) -> EulerSolutions:
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
    """Return for which sources (N, 6) with covariances (N, 6, 6) first-order intervals are valid.

    If the noise is not known, all count as valid.
    """
    variance = np.trace(covariance[:, :3, :3], axis1=1, axis2=2)
    with np.errstate(over="ignore"):  # a fit that was not found may be anywhere
        square = np.sum(unknowns[:, :3] ** 2, axis=1)
    return np.asarray((variance <= _MOST_UNCERTAIN**2 * square) | (not is_known))


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
    points, by_points = elements_of(array, array.operator[:8])
    return fit_fields(outputs, points, by_points, noise, start, index)


def fit_fields(
    values: FloatArray,
    points_m: FloatArray,
    by_points: FloatArray,
    noise: FloatArray,
    start: FloatArray,
    index: float = DIPOLE_INDEX,
) -> OutputFit:
    """Return the sources that fit what is linear in the fields at some points, each sample a problem of its own.

    Parameters
    ----------
    values : (N, D) array
        What is linear in the source's field.
    points_m : (P, 3) array
        Where the field is read, metres.
    by_points : (D, 3 P) array
        From the stacked fields there, tesla, to the values.
    noise : (D, D) or (N, D, D) array
        Covariance of the values, for all samples or each.
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
    whitening = whitening_of(noise)
    weights: FloatArray = whitening @ by_points
    data = (whitening @ values[..., None])[..., 0]
    if index != DIPOLE_INDEX:
        return fit_lines(data, points_m, weights, start, index)
    nothing = np.zeros((1, values.shape[1], 0))
    problem = Problem(dipole_field, points_m[None], weights[..., None, :, :], nothing)
    solution = solve(problem, data, start)
    with np.errstate(over="ignore", invalid="ignore"):
        field_T = dipole_field(-solution.unknowns[:, :3], solution.unknowns[:, 3:])[0]
        predicted, slopes = problem.predict(solution.unknowns)
    return OutputFit(solution, field_T, data - predicted, slopes)


def elements_of(array: Array, operator: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return where the field is read (P, 3), metres, and what makes values (D, 3 P) of the fields there.

    ``operator`` (D, 3 K) makes them of the readings.
    """
    if array.axis_offsets_m is None:
        return array.positions_m, operator
    # Each axis reads its own component where its element sits.
    by_elements = np.einsum("oka,ab->okab", operator.reshape(len(operator), -1, 3), np.eye(3))
    return array.element_positions_m.reshape(-1, 3), by_elements.reshape(len(operator), -1)


def whitening_of(noise: FloatArray) -> FloatArray:
    """Return a square root (…, D, D) of the inverse of covariances (…, D, D) of field and gradient.

    Raises
    ------
    InputError
        When one has no inverse.
    """
    variance = np.diagonal(noise, axis1=-2, axis2=-1)
    if not (np.isfinite(variance).all() and (variance > 0).all()):
        raise InputError("the covariance of field and gradient must have a positive, finite diagonal")
    scale = np.sqrt(variance)
    values, vectors = np.linalg.eigh(noise / scale[..., :, None] / scale[..., None, :])
    if values.min() <= 0:
        raise InputError("the covariance of field and gradient is singular or not a covariance")
    return np.asarray(np.swapaxes(vectors, -1, -2) / np.sqrt(values)[..., None] / scale[..., None, :])
