"""The position and moment of a source as a problem of least squares, many problems side by side.

The data of pose n are W_n times the stacked fields at the sensors there, plus whatever is linear in a few further
unknowns, plus white noise of size one. The steps are Levenberg's and Marquardt's, the derivatives analytic: the field's
by the source's position is minus its gradient.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution, solve_damped
from tam_calibration.model.units import FloatArray

Kernel = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
"""From offset and moment to field, gradient and the field's derivative by the moment: ``dipole_field`` is one."""

_SMALLEST_STEP = 1e-11
"""Part of a position, and of a moment, below which a step is the last."""


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
        """Return the unknowns at given positions, the moments and the further ones by linear least squares.

        The moment is found as that of a dipole.

        Parameters
        ----------
        data : (M, N D) array
            Whitened data of each of M problems.
        positions_m : (M, 3) array
            Of the source in each problem, metres.

        Returns
        -------
        (M, 6 + Q) array
            Position, moment and further unknowns.
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
class OutputFit:
    """Sources that were fitted to the outputs of N samples, each by itself.

    Parameters
    ----------
    solution : Solution
        Of each sample.
    field_T : (N, 3) array
        Of the sources at the array's centre, tesla.
    residuals : (N, 8) array
        Whitened.
    slopes : (N, 8, P) array
        Derivatives of the whitened outputs by what was fitted.
    """

    solution: Solution
    field_T: FloatArray
    residuals: FloatArray
    slopes: FloatArray


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

    def predict(unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        part = problem if problem.weights.ndim == 3 else replace(problem, weights=problem.weights[at])
        return part.predict(unknowns)

    with np.errstate(over="ignore"):  # what a step leads far away makes no field there, and is taken back
        return solve_damped(predict, data, start, _is_small)


def _is_small(unknowns: FloatArray, step: FloatArray) -> np.ndarray:
    """Return whether steps (M, 6 + Q) hardly change positions and moments."""
    size = norm(unknowns[:, :6].reshape(-1, 2, 3), axis=2)
    return np.asarray((norm(step[:, :6].reshape(-1, 2, 3), axis=2) <= _SMALLEST_STEP * size).all(axis=1))
