"""The sources that fit what an array reads, by least squares, many problems side by side: dipoles and lines.

The tensor of an array is a slope over its baselines, and what an array of length L reads r away from a dipole is not
the tensor at its centre: it differs by about (L/r)². The outputs, fitted with what the array makes of the fields at
its sensors, give the source without that error. The derivatives are exact: the field's by the position of a dipole
is minus its gradient.

A line goes through q along T. With w from q to a sensor and c = T × w a current has the field s h(c), h(c) = c/|c|²,
and a line of dipoles, which is a current less another one beside it, h'(c) (T × m), m across the line. The axes are
those of each sample's start: T = (c₁, c₂, 1) and q = (q₁, q₂, 0), with T along the third axis and q the nearest point
to the array's centre to begin with. So a current has five unknowns and a line of dipoles six, of the eight outputs; the
tensor always shows the line's direction, in which alone the field does not change.

Errors of the calibration and of the sensors' places count too. A corrected reading is b̂ = M̂⁻¹ (y - ô). With errors dM
and do of matrix and bias it is b - M⁻¹ (dM b + do) to first order: linear in the parameters, whose covariance the
calibration has. So a few unknowns of standard deviation one say all that may be wrong with the readings of a recording,
at most as many as there are parameters.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution, root_of, scaled, solution_at, solve_damped, with_slopes
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.recorded_attitude import across_of
from tam_calibration.localization.euler import CURRENT_INDEX, DIPOLE_INDEX, DIPOLES_INDEX
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field, field_by_moment

_SMALLEST = 1e-3
"""Effect on all readings, over the stated noise, below which an error is left out: beside a noise that is 30 times
smaller it adds a thousandth to χ²."""

PLACE_ERROR_M = 1e-3
"""Standard deviation of each coordinate of a sensor's place, metres, where readings show that places are not exact: of
a frame that was measured with a rule."""


def places_of(tensors: FloatArray, sensor_count: int) -> FloatArray:
    """Return the derivatives (N, 3 K, 3 K) of readings by the places of the sensors, T/m.

    Parameters
    ----------
    tensors : (N, 3, 3) array
        Gradient at each sample, T/m, taken as the same at all sensors.
    sensor_count : int
        K.
    """
    places = np.einsum("kl,nij->nkilj", np.eye(sensor_count), tensors)
    return np.asarray(places.reshape(len(tensors), 3 * sensor_count, 3 * sensor_count))


def errors_of(calibration: Calibration, fields_T: FloatArray, *, is_alternating: bool = False) -> FloatArray:
    """Return the derivatives (N, 3 K, Q) of corrected readings by errors of the calibration, tesla.

    Parameters
    ----------
    calibration : Calibration
        With the covariance of its errors.
    fields_T : (N, K, 3) array
        Corrected readings, array frame, tesla.
    is_alternating : bool
        Whether they are amplitudes, which a bias does not change.

    Returns
    -------
    (N, 3 K, Q) array
        For Q independent errors of mean zero and standard deviation one, Q at most 12 K.
    """
    shape = (len(fields_T), 3 * calibration.errors.sensor_count)
    full = np.pad(fields_T, ((0, 0), (0, 0), (0, 1)), constant_values=0.0 if is_alternating else 1.0)
    by_parameter = -calibration.errors.inverse[:, None] @ np.moveaxis(calibration.errors.jacobian(), 2, 1)
    root = root_of(calibration.covariance).reshape(calibration.errors.sensor_count, 12, -1)
    errors = np.einsum("nkd,kdip,kpq->nkiq", full, by_parameter, root, optimize=True).reshape(*shape, -1)
    seen = errors / np.repeat(calibration.array.vector_noise_T, 3)[:, None]
    squares, vectors = np.linalg.eigh(np.einsum("njp,njq->pq", seen, seen, optimize=True))
    return np.asarray(errors @ vectors[:, squares > _SMALLEST**2])


SMALLEST_STEP = 1e-11
"""Part of a shape below which a step is the last."""


@dataclass(frozen=True, eq=False)
class Fit(Solution):
    """The sources of N samples, fitted one by one.

    Unknowns are places and moments (N, 6) of dipoles; of lines the points nearest to the origin, and unit vectors along
    the lines. ``field_T`` (N, 3) is the field of each source at the origin, tesla.
    """

    field_T: FloatArray


def unknowns_of(index: float) -> int:
    """Return how many numbers a source of a structural index has."""
    return 5 if index == CURRENT_INDEX else 6


@dataclass(frozen=True, eq=False)
class Sources(ABC):
    """What is read of the sources of N samples: linear in their strengths, not in their shapes.

    The first unknowns of each are its shape, such as its place; the others are its strength.

    Parameters
    ----------
    points_m : (P, 3) or (N, P, 3) array
        Where the field is read, metres.
    weights : (N, D, 3 P) array
        From the stacked fields there to the whitened data of each.
    """

    points_m: FloatArray
    weights: FloatArray

    @abstractmethod
    def predict(self, unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the data (n, D) of some samples, and their derivatives (n, D, U) by the unknowns (n, U)."""

    @abstractmethod
    def by_strength(self, shapes: FloatArray, at: np.ndarray) -> FloatArray:
        """Return the derivatives (n, D, C) of the data of some samples by the strengths of sources of shapes (n, F)."""

    @abstractmethod
    def shapes(self, start: FloatArray) -> FloatArray:
        """Return the shapes (N, F) of places with moments or with vectors along lines (N, 6)."""

    @abstractmethod
    def fit_of(self, solution: Solution) -> Fit:
        """Return places, and moments or directions, from the solutions of all samples."""

    def with_strengths(
        self, data: FloatArray, shapes: FloatArray, at: np.ndarray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the unknowns (n, U) with the strengths that fit data (N, D) best for shapes (n, F).

        With them are the slopes (n, D, C) of the data by the strengths, and what makes strengths of the data (n, C, D).
        """
        slopes = self.by_strength(shapes, at)
        turned = np.swapaxes(slopes, 1, 2)
        unit, scale = scaled(np.nan_to_num(turned @ slopes, posinf=0.0, neginf=0.0))
        least = 1e-14 * np.eye(slopes.shape[2])  # far away there is no field, and the matrix is zero
        inverse = np.linalg.solve(unit + least, turned / scale[..., None]) / scale[..., None]
        strengths = (inverse @ data[at][..., None])[..., 0]
        return np.concatenate([shapes, strengths], axis=1), slopes, inverse

    def predict_projected(self, data: FloatArray, shapes: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the data of the strengths that fit best, and their derivatives (n, D, F) by the shape (Kaufman, 1975).

        Shapes alone converge where place and moment together creep along a bent valley.
        """
        unknowns, by_strength, inverse = self.with_strengths(data, shapes, at)
        predicted, slopes = self.predict(unknowns, at)
        by_shape = slopes[..., : shapes.shape[1]]
        return predicted, by_shape - by_strength @ (inverse @ by_shape)

    def fit(self, data: FloatArray, start: FloatArray) -> Fit:
        """Return the sources that fit data (N, D), from places with moments or with vectors along lines (N, 6)."""
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # where a step leads far away
            shapes = solve_damped(partial(self.predict_projected, data), data, self.shapes(start), hardly_moves)
            unknowns = self.with_strengths(data, shapes.unknowns, np.arange(len(data)))[0]
            return self.fit_of(solution_at(self.predict, data, unknowns, shapes.is_found))


class Dipoles(Sources):
    """What is read of dipoles: their shapes are their places, and their strengths their moments."""

    def predict(self, unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the data (n, D) of some samples, and their derivatives (n, D, 6) by place and moment (n, 6)."""
        place, moment = unknowns[:, None, :3], unknowns[:, None, 3:]
        field, gradient, by_moment = dipole_field(self.points_m - place, moment)
        slopes = np.concatenate([-gradient, by_moment], axis=-1).reshape(len(at), -1, 6)
        weights = self.weights[at]
        return (weights @ field.reshape(len(at), -1, 1))[..., 0], weights @ slopes

    def by_strength(self, shapes: FloatArray, at: np.ndarray) -> FloatArray:
        """Return the derivatives (n, D, 3) of the data of some samples by the moments of dipoles at places (n, 3)."""
        field = field_by_moment(self.points_m - shapes[:, None]).reshape(len(at), -1, 3)
        return np.asarray(self.weights[at] @ field)

    def shapes(self, start: FloatArray) -> FloatArray:
        """Return the places (N, 3) of places and moments (N, 6)."""
        return start[:, :3]

    def fit_of(self, solution: Solution) -> Fit:
        """Return the solutions as they are."""
        field_T = dipole_field(-solution.unknowns[:, :3], solution.unknowns[:, 3:])[0]
        return Fit(**vars(solution), field_T=field_T)


@dataclass(frozen=True, eq=False)
class Lines(Sources):
    """What is read of lines, along axes (N, 3, 3) of each sample in the array frame, as columns.

    The third axis is nearly along the line. ``points_m`` (N, P, 3) and ``weights`` are along these axes too. A shape is
    (q₁, q₂, c₁, c₂), and a strength one number of a current, and two of a line of dipoles.
    """

    axes: FloatArray
    index: float

    @classmethod
    def of(cls, points_m: FloatArray, weights: FloatArray, start: FloatArray, index: float) -> "Lines":
        """Return what is read along the axes of each line to begin with (N, 6)."""
        along = start[:, 3:] / norm(start[:, 3:], axis=1, keepdims=True)
        axes = np.concatenate([across_of(along), along[:, None]], axis=1)
        return cls.seen_along(np.swapaxes(axes, 1, 2), points_m, weights, index)

    @classmethod
    def seen_along(cls, axes: FloatArray, points_m: FloatArray, weights: FloatArray, index: float) -> "Lines":
        """Return what an array with points (P, 3) and weights (N, 8, 3 P) in its own frame reads along some axes."""
        by_sensor = weights.reshape(*weights.shape[:2], -1, 3) @ axes[:, None]
        return cls(points_m @ axes, by_sensor.reshape(weights.shape), axes, index)

    def predict(self, unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the whitened outputs (n, 8) of some samples, and their derivatives by the unknowns (n, 5 or 6)."""
        field, slopes = with_slopes(partial(_field, self.points_m[at], self.index), unknowns)
        weights, count = self.weights[at], len(at)
        data = (weights @ field.reshape(count, -1, 1))[..., 0]
        return data, weights @ slopes.reshape(count, -1, slopes.shape[-1])

    def by_strength(self, shapes: FloatArray, at: np.ndarray) -> FloatArray:
        """Return the derivatives (n, 8, 1 or 2) of the outputs of some samples by the strengths of lines."""
        units = np.eye(unknowns_of(self.index) - 4)[:, None].repeat(len(at), axis=1)
        lines = [np.concatenate([shapes, unit], axis=1) for unit in units]
        fields = np.stack([_field(self.points_m[at], self.index, each) for each in lines], axis=-1)
        return np.asarray(self.weights[at] @ fields.reshape(len(at), -1, len(units)))

    def shapes(self, start: FloatArray) -> FloatArray:
        """Return lines (N, 4) along the third axis, through places of which (N, 6) begins."""
        across = (np.swapaxes(self.axes, 1, 2) @ start[:, :3, None])[:, :2, 0]
        return np.pad(across, ((0, 0), (0, 2)))

    def fit_of(self, solution: Solution) -> Fit:
        """Return the nearest points of lines and unit vectors along them (N, 6), in the array frame."""
        unknowns, slopes = with_slopes(_nearest, solution.unknowns)
        turn = np.kron(np.eye(2), self.axes)
        slopes = turn @ slopes[..., :4]
        covariance = slopes @ solution.covariance[:, :4, :4] @ np.swapaxes(slopes, 1, 2)
        field = _field(np.zeros((len(unknowns), 1, 3)), self.index, solution.unknowns).swapaxes(1, 2)
        turned = (turn @ unknowns[..., None])[..., 0]
        return Fit(turned, covariance, solution.chi_square, solution.is_found, (self.axes @ field)[..., 0])


def _field(points_m: FloatArray, index: float, unknowns: Any) -> Any:
    """Return the fields (n, P, 3) of lines with unknowns (n, 5 or 6) at points (n, P, 3)."""
    place, along = _place_and_along(unknowns)
    across = np.cross(along[:, None], points_m - place[:, None])
    square = _dot(across, across)
    if index == CURRENT_INDEX:
        return unknowns[:, None, 4:] * across / square
    shift = np.cross(along, np.pad(unknowns[:, 4:], ((0, 0), (0, 1))))[:, None]
    return (shift - 2 * across * _dot(across, shift) / square) / square


def _nearest(unknowns: Any) -> Any:
    """Return the nearest points and directions (N, 6) of lines."""
    place, along = _place_and_along(unknowns)
    unit = along / np.sqrt(_dot(along, along))
    return np.concatenate([place - _dot(place, unit) * unit, unit], axis=1)


def _place_and_along(unknowns: Any) -> tuple[Any, Any]:
    """Return a point q (n, 3) of each line, and the vector T (n, 3) along it."""
    none = np.zeros((len(unknowns), 1))
    return np.concatenate([unknowns[:, :2], none], axis=1), np.concatenate([unknowns[:, 2:4], none + 1.0], axis=1)


def _dot(one: Any, other: Any) -> Any:
    return np.sum(one * other, axis=-1, keepdims=True)


SOURCES = {CURRENT_INDEX: "line of current", DIPOLES_INDEX: "line of dipoles", DIPOLE_INDEX: "dipole"}
"""Of each structural index."""


def hardly_moves(shapes: FloatArray, step: FloatArray) -> np.ndarray:
    """Return whether steps (N, F) hardly change shapes (N, F)."""
    return np.asarray(norm(step, axis=1) <= SMALLEST_STEP * norm(shapes, axis=1))


def fit_fields(
    values: FloatArray,
    points_m: FloatArray,
    by_points: FloatArray,
    noise: FloatArray,
    start: FloatArray,
    index: float = DIPOLE_INDEX,
) -> Fit:
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

    Raises
    ------
    InputError
        When a covariance has no inverse.
    """
    whitening = whitening_of(noise)
    data = (whitening @ values[..., None])[..., 0]
    weights = np.broadcast_to(whitening @ by_points, (len(values), *by_points.shape))
    if index == DIPOLE_INDEX:
        return Dipoles(points_m, weights).fit(data, start)
    return Lines.of(points_m, weights, start, index).fit(data, start)


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


def start_of(euler: EulerSolutions, index: float) -> FloatArray:
    """Return where fits begin (N, 6): Euler's places, and the moments of dipoles or vectors along lines."""
    return np.concatenate([euler.position_m, euler.moment_Am2 if index == DIPOLE_INDEX else euler.along], axis=1)


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


def require_gradient(array: Array) -> None:
    """Refuse an array whose geometry determines no gradient.

    Raises
    ------
    InputError
        When it is such an array.
    """
    if not array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
