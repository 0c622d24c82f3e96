"""The sources that fit what an array reads, by least squares, many problems side by side.

The tensor of an array is a slope over its baselines, and what an array of length L reads r away from a dipole is not
the tensor at its centre: it differs by about (L/r)². The outputs, fitted with what the array makes of the fields at
its sensors, give the source without that error. The derivatives are analytic: the field's by the position of a dipole
is minus its gradient.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import scaled, solution_at, solve_damped
from tam_calibration.localization.euler import DIPOLE_INDEX, locate
from tam_calibration.localization.line_fit import CURRENT_INDEX, DIPOLES_INDEX, OutputFit, directions_of, fit_lines
from tam_calibration.localization.solutions import EulerSolutions, Status, in_pieces
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field, field_by_moment

SOURCES = {CURRENT_INDEX: "line of current", DIPOLES_INDEX: "line of dipoles", DIPOLE_INDEX: "dipole"}
"""Of each structural index."""


@dataclass(frozen=True, eq=False)
class Dipoles:
    """What is read of the dipoles of N samples.

    Parameters
    ----------
    points_m : (P, 3) array
        Where the field is read, metres.
    weights : (N, D, 3 P) array
        From the stacked fields there to the whitened data of each.
    """

    points_m: FloatArray
    weights: FloatArray

    def predict(self, unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the data (n, D) of some samples, and their derivatives (n, D, 6) by place and moment (n, 6)."""
        place, moment = unknowns[:, None, :3], unknowns[:, None, 3:]
        field, gradient, by_moment = dipole_field(self.points_m - place, moment)
        slopes = np.concatenate([-gradient, by_moment], axis=-1).reshape(len(at), -1, 6)
        weights = self.weights[at]
        return (weights @ field.reshape(len(at), -1, 1))[..., 0], weights @ slopes

    def with_moments(
        self, data: FloatArray, places_m: FloatArray, at: np.ndarray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return places with the moments (n, 6) that fit data (N, D) best there.

        With them are the slopes (n, D, 3) of the data by the moments, and what makes the moments of the data (n, 3, D).
        """
        field = field_by_moment(self.points_m - places_m[:, None]).reshape(len(at), -1, 3)
        slopes = self.weights[at] @ field
        turned = np.swapaxes(slopes, 1, 2)
        unit, scale = scaled(np.nan_to_num(turned @ slopes, posinf=0.0, neginf=0.0))
        least = 1e-14 * np.eye(3)  # far away there is no field, and the matrix is zero
        inverse = np.linalg.solve(unit + least, turned / scale[..., None]) / scale[..., None]
        moments = (inverse @ data[at][..., None])[..., 0]
        return np.concatenate([places_m, moments], axis=1), slopes, inverse

    def predict_projected(
        self, data: FloatArray, places_m: FloatArray, at: np.ndarray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the data of the moments that fit best, and their derivatives (n, D, 3) by the place (Kaufman, 1975).

        Places alone converge where place and moment together creep along a bent valley.
        """
        unknowns, by_moment, inverse = self.with_moments(data, places_m, at)
        predicted, slopes = self.predict(unknowns, at)
        by_place = slopes[..., :3]
        return predicted, by_place - by_moment @ (inverse @ by_place)


def _is_small(places_m: FloatArray, step: FloatArray) -> np.ndarray:
    """Return whether steps (N, 3) hardly change places."""
    return np.asarray(norm(step, axis=1) <= 1e-11 * norm(places_m, axis=1))


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
    data = (whitening @ values[..., None])[..., 0]
    weights = np.broadcast_to(whitening @ by_points, (len(values), *by_points.shape))
    if index != DIPOLE_INDEX:
        return fit_lines(data, points_m, weights, start, index)
    dipoles, all_of_them = Dipoles(points_m, weights), np.arange(len(values))
    with np.errstate(over="ignore", invalid="ignore"):  # what a step leads far away makes no field there
        places = solve_damped(partial(dipoles.predict_projected, data), data, start[:, :3], _is_small)
        unknowns = dipoles.with_moments(data, places.unknowns, all_of_them)[0]
        solution = solution_at(dipoles.predict, data, unknowns, places.is_found)
        field_T = dipole_field(-unknowns[:, :3], unknowns[:, 3:])[0]
        predicted, slopes = dipoles.predict(unknowns, all_of_them)
    return OutputFit(solution, field_T, data - predicted, slopes)


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
    """
    points, by_points = elements_of(array, array.operator[:8])
    return fit_fields(outputs, points, by_points, noise, start, index)


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
    unit, scale = scaled(noise)
    values, vectors = np.linalg.eigh(unit)
    if values.min() <= 0:
        raise InputError("the covariance of field and gradient is singular or not a covariance")
    return np.asarray(np.swapaxes(vectors, -1, -2) / np.sqrt(values)[..., None] / scale[..., None, :])


def start_of(euler: EulerSolutions, outputs: FloatArray, index: float) -> FloatArray:
    """Return where fits begin (N, 6): Euler's places, and the moments of dipoles or vectors along lines."""
    vectors = euler.moment_Am2 if index == DIPOLE_INDEX else directions_of(outputs)
    return np.concatenate([euler.position_m, vectors], axis=1)


_MOST_UNCERTAIN = 0.2
"""Standard error of a place over its distance: beyond, intervals of first order no longer hold what they say."""


def is_certain(unknowns: FloatArray, covariance: FloatArray) -> np.ndarray:
    """Return for which sources (N, 6) with covariances (N, 6, 6) first-order intervals are valid."""
    variance = np.trace(covariance[:, :3, :3], axis1=1, axis2=2)
    with np.errstate(over="ignore"):  # a fit that was not found may be anywhere
        return np.asarray(variance <= _MOST_UNCERTAIN**2 * np.sum(unknowns[:, :3] ** 2, axis=1))


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
    if index not in SOURCES:
        raise InputError(
            "the structural index must be 3 of a dipole, 2 of a line of dipoles or 1 of a line of current, not "
            f"{index:g}"
        )


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


def _fitted(array: Array, index: float, outputs: FloatArray, covariance: FloatArray | None) -> EulerSolutions:
    euler = locate(outputs, covariance, index=index)
    at = np.flatnonzero(euler.is_located)
    if not len(at):
        return euler
    operator = array.operator[:8]
    noise = operator @ operator.T if covariance is None else np.asarray(covariance, dtype=float)[..., :8, :8]
    start = start_of(euler, outputs, index)[at]
    solution = fit_outputs(outputs[at, :8], array, noise if noise.ndim == 2 else noise[at], start, index).solution
    is_sure = solution.is_found
    if covariance is not None:
        is_sure = is_sure & is_certain(solution.unknowns, solution.covariance)
    status = euler.status.copy()
    status[at[~is_sure]] = Status.UNCERTAIN
    found = EulerSolutions.of_fits(status, solution.take(is_sure), index == DIPOLE_INDEX)
    return found if covariance is not None else found.without_covariance()
