"""Nonlinear least squares: damped steps for many small problems side by side."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from tam_calibration.model.units import FloatArray

Predict = Callable[[FloatArray, np.ndarray], tuple[FloatArray, FloatArray]]
"""From unknowns (m, P) of the problems at an index (m,) to their data (m, D) and these' derivatives (m, D, P)."""

IsSmall = Callable[[FloatArray, FloatArray], np.ndarray]
"""From unknowns (m, P) and the steps (m, P) to them to which (m,) of these are the last."""

_MOST_STEPS = 60
"""Damped steps after which a problem that has not settled is left where it is."""


def whitening(matrix: FloatArray, least: float) -> FloatArray:
    """Return W (Q, P) with Wᵀ M W = 1 over the directions in which a positive semidefinite matrix M (Q, Q) is not zero.

    Parameters
    ----------
    matrix : (Q, Q) array
        A covariance, or an information.
    least : float
        Part of the largest eigenvalue below which one counts as zero, the matrix scaled to a diagonal of ones.
    """
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    inverse = np.divide(1, size, out=np.zeros_like(size), where=size > 0)
    values, vectors = np.linalg.eigh(matrix * np.outer(inverse, inverse))
    seen = values > least * values[-1]
    return np.asarray(inverse[:, None] * vectors[:, seen] / np.sqrt(values[seen]))


def scaled(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return normal matrices (..., P, P) with a diagonal of ones, and the roots (..., P) of what it was.

    Where the diagonal is not positive it stays as it is.
    """
    diagonal = np.diagonal(normal, axis1=-2, axis2=-1)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return normal / scale[..., :, None] / scale[..., None, :], scale


def root_of(covariance: FloatArray) -> FloatArray:
    """Return a square root (P, P) of a covariance (P, P), exactly zero where its diagonal is."""
    size = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    values, vectors = np.linalg.eigh(scaled(covariance)[0])
    return np.asarray(size[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares solutions of M problems.

    Parameters
    ----------
    unknowns : (M, P) array
        What is sought.
    covariance : (M, P, P) array
        For data of unit noise.
    chi_square : (M,) array
        Sum of the squared residuals.
    is_found : (M,) array of bool
        Whether the steps converged and the data determine every unknown.
    """

    unknowns: FloatArray
    covariance: FloatArray
    chi_square: FloatArray
    is_found: np.ndarray

    def take(self, at: np.ndarray) -> Self:
        """Return those of some problems."""
        return replace(self, **{name: value[at] for name, value in vars(self).items()})


def solve_damped(
    predict: Predict, data: FloatArray, start: FloatArray, is_small: IsSmall, most_steps: int = _MOST_STEPS
) -> Solution:
    """Return the solutions of M problems by steps of Levenberg and Marquardt; none depends on its neighbours.

    Parameters
    ----------
    predict : Predict
        What makes the data.
    data : (M, D) array
        Whitened.
    start : (M, P) array
        Where to begin.
    is_small : IsSmall
        When the steps end.
    most_steps : int
        After which a problem that has not settled is left where it is.
    """
    unknowns = np.array(start, dtype=float)
    # 1e-3 and 1e12: added to a diagonal of one: nearly a Gauss-Newton step, and one so short that no shorter one lowers
    # χ² either.
    damping = np.full(len(data), 1e-3)
    is_open, is_found = np.full(len(data), True), np.full(len(data), False)
    chi_square, normal, slope = _linearize(predict, data, unknowns, np.arange(len(data)))
    # Part of the squares of the data by which rounding may raise χ².
    rounding = 1e-13 * np.sum(data**2, axis=1)
    for _ in range(most_steps):
        if not is_open.any():
            break
        at = np.flatnonzero(is_open)
        unit, scale = scaled(normal[at])
        damped = unit + damping[at, None, None] * np.eye(normal.shape[1])
        change = np.linalg.solve(damped, (slope[at] / scale)[..., None])[..., 0] / scale
        tried = unknowns[at] + change
        new_chi_square, new_normal, new_slope = _linearize(predict, data[at], tried, at)
        is_better = new_chi_square <= chi_square[at] + rounding[at]
        better = at[is_better]
        unknowns[better], chi_square[better] = tried[is_better], new_chi_square[is_better]
        normal[better], slope[better] = new_normal[is_better], new_slope[is_better]
        # Added to a diagonal of one: fifty times its rounding, so that equal unknowns make no singular matrix.
        # 0.03 and 10.0: by what the damping is multiplied after a step that lowers χ², and after one that does not.
        damping[at] = np.maximum(damping[at] * np.where(is_better, 0.03, 10.0), 1e-14)
        is_last = is_small(unknowns[at], change)
        is_found[at[is_last]] = True
        is_open[at[is_last | (damping[at] > 1e12)]] = False
    return _solution(unknowns, chi_square, normal, is_found)


def solution_at(predict: Predict, data: FloatArray, unknowns: FloatArray, is_found: np.ndarray) -> Solution:
    """Return the solutions of M problems whose unknowns (M, P) are known."""
    chi_square, normal, _ = _linearize(predict, data, unknowns, np.arange(len(data)))
    return _solution(unknowns, chi_square, normal, is_found)


def _solution(unknowns: FloatArray, chi_square: FloatArray, normal: FloatArray, is_found: np.ndarray) -> Solution:
    covariance, is_determined = _invert(normal)
    return Solution(unknowns, covariance, chi_square, is_found & is_determined & np.isfinite(unknowns).all(axis=1))


def _linearize(
    predict: Predict, data: FloatArray, unknowns: FloatArray, at: np.ndarray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return χ² (M,), infinite where it is not finite, normal matrix (M, P, P) and right-hand side (M, P)."""
    predicted, derivative = predict(unknowns, at)
    residual = data - predicted
    turned = np.swapaxes(derivative, 1, 2)
    chi_square = np.sum(residual**2, axis=1)
    finite = np.where(np.isfinite(chi_square), chi_square, np.inf)
    return finite, turned @ derivative, (turned @ residual[..., None])[..., 0]


def _invert(normal: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return the inverses (M, P, P) and whether each exists; NaN where it does not."""
    unit, scale = scaled(np.where(np.isfinite(normal), normal, 0.0))
    values, vectors = np.linalg.eigh(unit)
    # Of scaled normal equations that determine every unknown.
    exists = values[:, 0] > values[:, -1] / 1e12
    inverse = vectors / np.where(exists[:, None], values, np.nan)[:, None, :] @ np.swapaxes(vectors, 1, 2)
    return inverse / scale[:, :, None] / scale[:, None, :], exists
