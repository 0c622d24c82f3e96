"""Euler localisation: a source's position from the field and the gradient tensor that it makes in one place.

A field that falls with the n-th power of the distance fulfils Euler's equation G r = -n B, with r from the source to
the array. n is the structural index: 3 for a dipole, 2 for a line of dipoles, 1 for a line of current. The constrained
solution takes r in the plane across the eigenvector of smallest |eigenvalue|, to which a dipole's r is at right angles
(Wu 2025 section 3.2): r = -n Σ (vₖᵀB/λₖ) vₖ over the other two. Without a trace these two cannot be small, so the
constrained solution needs no regularisation, where the unconstrained G⁻¹ breaks down as the moment turns across r.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tam_calibration.core.least_squares import ROUNDING, Solution, with_slopes
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.model.array import UNIT_TENSORS, tensors_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import is_covariance
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import moment_of_field

CURRENT_INDEX, DIPOLES_INDEX, DIPOLE_INDEX = 1.0, 2.0, 3.0
"""Structural indices of a line of current, a line of dipoles, and a dipole."""

_FIELD_CHI_SQUARE, _TENSOR_CHI_SQUARE, _DEVIATIONS = 14.16, 18.21, 3.0
"""99.73 % points of χ² with 3 and 5 degrees of freedom, as rare as three standard deviations."""


def locate(
    outputs: FloatArray, covariance: FloatArray | None = None, *, index: float = DIPOLE_INDEX, constrained: bool = True
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
    outputs, noise = _check(outputs, covariance, index)
    found = _locate(outputs, noise, index, constrained)
    return found if covariance is not None else found.without_covariance()


def _locate(outputs: FloatArray, noise: FloatArray, index: float, constrained: bool) -> EulerSolutions:
    is_finite = np.asarray(np.isfinite(outputs).all(axis=1) & np.isfinite(noise).all(axis=(1, 2)))
    outputs, noise = np.where(is_finite[:, None], outputs, 0.0), np.where(is_finite[:, None, None], noise, 0.0)
    system = _System.of(outputs, noise, constrained)
    least = _DEVIATIONS * system.deviations[:, 2] + ROUNDING * np.abs(system.values[:, 0])
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        r, by_output = system.solve(index)
        moment, slopes = with_slopes(_moment, np.concatenate([r, outputs[:, :3]], axis=1))
        by_output = np.concatenate([by_output, slopes[..., :3] @ by_output], axis=1)
        by_output[:, 3:, :3] += slopes[..., 3:]
        covariance = by_output @ noise @ np.swapaxes(by_output, 1, 2)
        change = system.change_by_other(index) if constrained else np.zeros_like(r)
        variance, square = np.trace(covariance[:, :3, :3], axis1=1, axis2=2), np.sum(r**2, axis=1)
        change_square = np.sum(change**2, axis=1)
        covariance[:, :3, :3] += change[:, :, None] * change[:, None, :]
        reasons = {
            Status.NOT_FINITE: ~is_finite,
            Status.NO_FIELD: _is_hidden(outputs[:, :3], noise[:, :3, :3], _FIELD_CHI_SQUARE),
            Status.NO_GRADIENT: _is_hidden(outputs[:, 3:], noise[:, 3:, 3:], _TENSOR_CHI_SQUARE),
            Status.ILL_CONDITIONED: (np.abs(system.values[:, 2]) <= least) & (not constrained),
            Status.AMBIGUOUS: change_square > _DEVIATIONS**2 * variance + 1e-6 * square,
            Status.UNCERTAIN: ~(variance + change_square <= square),
        }
    status = np.select(list(reasons.values()), list(reasons), Status.LOCATED)
    is_dipole, is_located = index == DIPOLE_INDEX, status == Status.LOCATED
    unknowns = np.concatenate([-r, moment if is_dipole else system.vectors[..., 2]], axis=1)
    every = Solution(unknowns, covariance, np.full(len(r), np.nan), is_located)
    return EulerSolutions.of_fits(status, every.take(is_located), is_dipole)


def _moment(place_and_field: Any) -> Any:
    return moment_of_field(place_and_field[:, :3], place_and_field[:, 3:])


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
        return gap <= _DEVIATIONS * self.gap_deviation + ROUNDING * np.abs(self.values[:, 0])

    def change_by_other(self, index: float) -> FloatArray:
        """Return how r (N, 3) would change with the other of two equal eigenvectors left out; zero without such."""
        other = np.where([False, True, True], 1 / self.values, 0.0) * self.field * np.array([0, -1, 1])
        change = -index * np.einsum("nik,nk->ni", self.vectors, other)
        return np.where(self.is_gap_hidden[:, None], change, 0.0)

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
    covariance = np.zeros((8, 8)) if covariance is None else np.asarray(covariance, dtype=float)
    if covariance.shape[-2:] not in ((8, 8), (9, 9)) or covariance.shape[:-2] not in ((), (count,)):
        raise InputError(
            f"the covariance must be (9, 9) or (8, 8), one for all or each of {count} samples, not {covariance.shape}"
        )
    covariance = covariance[..., :8, :8]
    if not is_covariance(covariance[np.isfinite(covariance).all(axis=(-2, -1))]):
        raise InputError("the covariance of field and gradient must be symmetric and positive definite")
    return outputs[:, :8], np.broadcast_to(covariance, (count, 8, 8))


def _is_hidden(values: FloatArray, noise: FloatArray, chi_square: float) -> np.ndarray:
    """Return whether values (N, D) with noise (N, D, D) are zero, or cannot be told from zero."""
    size = np.sum(values**2, axis=1)
    # In the metric of the noise |v|² ≤ χ² is v vᵀ ≤ χ² Σ; noise that is zero needs no inverse.
    largest = np.linalg.eigvalsh(chi_square * noise - values[:, :, None] * values[:, None, :])[:, 0]
    return np.asarray((size == 0) | (largest >= 0) & (np.trace(noise, axis1=1, axis2=2) > 0))
