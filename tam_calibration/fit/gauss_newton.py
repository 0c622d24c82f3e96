"""Gauss-Newton steps over the parameters of a fit that a uniform field determines, until rounding stops them."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

from tam_calibration.core.least_squares import scaled
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.likelihood import UNIFORM, Linearization
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray

Place = TypeVar("Place")
Kept = TypeVar("Kept")


_NOT_ONE = "the readings do not fit one calibration, look for a change of field or sensor during the recording"


class Point(NamedTuple):
    """Matrices D Λ (K, 3, 3), biases (K, 3), and components of an ambient gradient: five, or none."""

    matrix: FloatArray
    bias: FloatArray
    gradient: FloatArray = UNIFORM


def free_rows(count: int) -> np.ndarray:
    """Return which of the rows of [D Λ | o] are fitted: not what lies below the diagonal of the first matrix."""
    free = np.ones(12 * count, dtype=bool)
    free[[4, 8, 9]] = False
    return free


def gauss_newton(
    linearize: Callable[[Point], Linearization], point: Point, robust: bool = False
) -> tuple[Point, FloatArray]:
    """Return the point where the iteration settles, and the information a last step before, far below its errors.

    Parameters
    ----------
    linearize : Callable
        Information and gradient of the likelihood at a point, both over all parameters.
    point : Point
        Where to begin.
    robust : bool
        Whether the weights of the samples change from step to step.

    Raises
    ------
    InputError
        When the readings determine no ellipsoid.
    Refused
        When the iteration does not settle, or goes astray.
    """
    rows = 12 * len(point.matrix)
    free = np.append(free_rows(len(point.matrix)), np.ones(len(point.gradient), dtype=bool))

    def normal_at(there: Point) -> tuple[FloatArray, FloatArray, FloatArray]:
        here = linearize(there).both
        return here.information[np.ix_(free, free)], here.score[free], here.information

    def moved(before: Point, change: FloatArray) -> Point:
        # Size of a step of matrices and biases, which are of order one, from which no way leads back.
        if not np.abs(change).max() < 1e6:
            raise Refused(f"the fit goes astray: {_NOT_ONE}")
        step = np.zeros(free.size)
        step[free] = change
        update = step[:rows].reshape(-1, 3, 4)
        return Point(before.matrix + update[..., :3], before.bias + update[..., 3], before.gradient + step[rows:])

    return descend(normal_at, moved, point, robust)


def descend(
    normal_at: Callable[[Place], tuple[FloatArray, FloatArray, Kept]],
    moved: Callable[[Place, FloatArray], Place],
    place: Place,
    robust: bool = False,
) -> tuple[Place, Kept]:
    """Return the place where Gauss-Newton steps settle, and what was kept a last step before.

    Parameters
    ----------
    normal_at : callable
        From a place to the information (M, M) of what is free there, the downhill gradient (M,), and what to keep.
    moved : callable
        From a place and a step (M,) to the next place.
    place : Place
        Where to begin.
    robust : bool
        Whether the weights of the samples change from step to step.

    Raises
    ------
    InputError
        When the information is singular.
    Refused
        When the iteration does not settle.
    """
    before = np.inf
    for _ in range(100):
        information, gradient, kept = normal_at(place)
        step = newton_step(information, gradient)
        # Twice the fall of the likelihood that the step promises; below one it is part of a standard error.
        decrement = float(step @ gradient)
        # Newton's steps fall quadratically until rounding stops them, those with new weights by a constant factor.
        is_rounding = not robust and decrement < 1e-2 and decrement > before / 4
        place, before = moved(place, step), decrement
        if is_rounding or decrement < (1e-5 if robust else 1e-6):
            return place, kept
    raise Refused(f"the fit did not settle in 100 steps: {_NOT_ONE}")


@ellipsoid.determined()
def newton_step(information: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the step (M,) to the maximum of a parabola, with its information (M, M) and downhill gradient (M,).

    Raises
    ------
    InputError
        When the information is singular.
    """
    unit, scale = scaled(information)
    if not (np.diag(information) > 0).all():
        raise InputError(ellipsoid.NO_ELLIPSOID)
    return np.asarray(np.linalg.solve(unit, gradient / scale) / scale)
