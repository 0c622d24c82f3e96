"""Nonlinear least squares for the position and moment of a source, many problems side by side.

The data of pose n are W_n times the stacked fields at the sensors there, plus whatever is linear in a few further
unknowns, plus white noise of size one. The steps are Levenberg's and Marquardt's, the derivatives analytic: the field's
by the source's position is minus its gradient.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.units import FloatArray

Kernel = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""From offset and moment to field, gradient and the field's derivative by the moment: ``dipole_field`` is one."""

_STEPS = 60
_SMALLEST_STEP = 1e-11
_ROUNDING = 1e-13
_LARGEST_CONDITION = 1e12


@dataclass(frozen=True, eq=False)
class Problem:
    """What makes the data out of a source.

    Parameters
    ----------
    kernel : Kernel
        The source's field.
    points_m : (N, K, 3) array
        Where the sensors are in each of N poses, in the frame of the source.
    weights : (N, D, 3 K) or (M, N, D, 3 K) array
        From the stacked fields of a pose to its whitened data, for all of M problems or each.
    linear : (N, D, Q) array
        From further unknowns to the whitened data.
    """

    kernel: Kernel
    points_m: FloatArray
    weights: FloatArray
    linear: FloatArray

    def predict(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the data (M, N D) and their derivatives (M, N D, 6 + Q) by unknowns (M, 6 + Q)."""
        position, moment, rest = np.split(unknowns, (3, 6), axis=1)
        problems, (poses, sensors) = len(unknowns), self.points_m.shape[:2]
        field, gradient, by_moment = self.kernel(self.points_m - position[:, None, None], moment[:, None, None])
        slopes = np.concatenate([-gradient, by_moment], axis=-1).reshape(problems, poses, 3 * sensors, 6)
        stacked = field.reshape(problems, poses, 3 * sensors, 1)
        linear = np.broadcast_to(self.linear, (problems, *self.linear.shape))
        data = (self.weights @ stacked)[..., 0] + np.einsum("mndq,mq->mnd", linear, rest)
        derivative = np.concatenate([self.weights @ slopes, linear], axis=-1)
        return data.reshape(problems, -1), derivative.reshape(problems, data[0].size, -1)

    def start(self, data: FloatArray, positions_m: FloatArray) -> FloatArray:
        """Return the unknowns (M, 6 + Q) at given positions (M, 3), whose moments follow from data (M, N D) linearly.

        The moment is found as that of a dipole.
        """
        moment = np.broadcast_to([0.0, 0.0, 1.0], positions_m.shape)
        further = np.zeros((len(positions_m), self.linear.shape[2]))
        _, derivative = self.predict(np.concatenate([positions_m, moment, further], axis=1))
        slopes = derivative[..., 3:]
        scale = norm(slopes, axis=1)
        unit = slopes / scale[:, None]
        found = (np.linalg.pinv(unit) @ data[..., None])[..., 0] / scale
        return np.concatenate([positions_m, found], axis=1)


@dataclass(frozen=True, eq=False)
class Solution:
    """The least-squares solutions of M problems.

    Parameters
    ----------
    unknowns : (M, 6 + Q) array
        Position, moment, further unknowns.
    covariance : (M, 6 + Q, 6 + Q) array
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


def solve(problem: Problem, data: FloatArray, start: FloatArray) -> Solution:
    """Return the solutions of M problems; each takes its own steps and does not depend on its neighbours.

    Parameters
    ----------
    problem : Problem
        What makes the data.
    data : (M, N D) array
        Whitened.
    start : (M, 6 + Q) array
        Where to begin.
    """
    unknowns = np.array(start, dtype=float)
    damping = np.full(len(data), 1e-3)
    is_open, is_found = np.full(len(data), True), np.full(len(data), False)
    misfit, normal, slope = _linearize(problem, data, unknowns)
    rounding = _ROUNDING * np.sum(data**2, axis=1)
    for _ in range(_STEPS):
        at = np.flatnonzero(is_open)
        if not len(at):
            break
        step = _step(normal[at], slope[at], damping[at])
        part = problem if problem.weights.ndim == 3 else _take(problem, at)
        tried = unknowns[at] + step
        new_misfit, new_normal, new_slope = _linearize(part, data[at], tried)
        is_better = new_misfit <= misfit[at] + rounding[at]
        better = at[is_better]
        unknowns[better], misfit[better] = tried[is_better], new_misfit[is_better]
        normal[better], slope[better] = new_normal[is_better], new_slope[is_better]
        damping[at] *= np.where(is_better, 0.03, 10)
        small = _SMALLEST_STEP * norm(unknowns[at].reshape(len(at), -1)[:, :6].reshape(-1, 2, 3), axis=2)
        is_small = (norm(step[:, :6].reshape(-1, 2, 3), axis=2) <= small).all(axis=1)
        is_found[at[is_small]] = True
        is_open[at[is_small | (damping[at] > 1e12)]] = False
    covariance, is_determined = _invert(normal)
    return Solution(unknowns, covariance, misfit, is_found & is_determined & np.isfinite(unknowns).all(axis=1))


def _linearize(problem: Problem, data: FloatArray, unknowns: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return misfit (M,), normal matrix (M, P, P) and right-hand side (M, P); infinite misfit where not finite."""
    predicted, derivative = problem.predict(unknowns)
    residual = data - predicted
    turned = np.swapaxes(derivative, 1, 2)
    misfit = np.sum(residual**2, axis=1)
    return np.where(np.isfinite(misfit), misfit, np.inf), turned @ derivative, (turned @ residual[..., None])[..., 0]


def _step(normal: FloatArray, slope: FloatArray, damping: FloatArray) -> FloatArray:
    unit, scale = _scaled(normal)
    damped = unit + damping[:, None, None] * np.eye(normal.shape[1])
    step: FloatArray = np.linalg.solve(damped, (slope / scale)[..., None])[..., 0] / scale
    return step


def _scaled(normal: FloatArray) -> tuple[FloatArray, FloatArray]:
    diagonal = np.diagonal(normal, axis1=1, axis2=2)
    scale = np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    return normal / scale[:, :, None] / scale[:, None, :], scale


def _invert(normal: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return the inverses (M, P, P) and whether each exists; NaN where it does not."""
    unit, scale = _scaled(np.where(np.isfinite(normal), normal, 0.0))
    values, vectors = np.linalg.eigh(unit)
    exists = values[:, 0] > values[:, -1] / _LARGEST_CONDITION
    inverse = vectors / np.where(exists[:, None], values, np.nan)[:, None, :] @ np.swapaxes(vectors, 1, 2)
    return inverse / scale[:, :, None] / scale[:, None, :], exists


def _take(problem: Problem, at: np.ndarray) -> Problem:
    return Problem(problem.kernel, problem.points_m, problem.weights[at], problem.linear)
