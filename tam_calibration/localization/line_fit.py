"""A line of current, or of dipoles, from what an array makes of it at its sensors: without the error of baselines.

A line goes through q along T. With w from q to a sensor and c = T × w a current has the field s h(c), h(c) = c/|c|²,
and a line of dipoles, which is a current less another one beside it, h'(c) (T × m), m across the line. The axes are
those of each sample's start: T = (c₁, c₂, 1) and q = (q₁, q₂, 0), with T along the third axis and q the nearest point
to the array's centre to begin with. So a current has five unknowns and a line of dipoles six, of the eight outputs; the
tensor always shows the line's direction, in which alone the field does not change.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution, solve_damped
from tam_calibration.model.array import tensors_of
from tam_calibration.model.units import FloatArray

CURRENT_INDEX, DIPOLES_INDEX = 1.0, 2.0
"""Structural indices of a line of current and of a line of dipoles."""

_SMALLEST_STEP = 1e-11
"""Part of a distance, of radians and of a strength below which a step is the last."""

_ACROSS = np.eye(3)[:2]


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


def unknowns_of(index: float) -> int:
    """Return how many numbers a source of a structural index has."""
    return 5 if index == CURRENT_INDEX else 6


def directions_of(outputs: FloatArray) -> FloatArray:
    """Return the unit vectors (N, 3) along which the tensors of outputs (N, 8) or (N, 9) change the field least."""
    values, vectors = np.linalg.eigh(tensors_of(outputs))
    least = np.abs(values).argmin(axis=1)
    return np.take_along_axis(vectors, least[:, None, None], axis=2)[..., 0]


def fit_lines(
    data: FloatArray, points_m: FloatArray, weights: FloatArray, start: FloatArray, index: float
) -> OutputFit:
    """Return the lines that fit whitened outputs, each sample a problem of its own.

    Parameters
    ----------
    data : (N, 8) array
        Whitened outputs.
    points_m : (P, 3) array
        Where the field is read, array frame, metres.
    weights : (N, 8, 3 P) array
        From the stacked fields there to the whitened outputs.
    start : (N, 6) array
        A place on each line [m], and a vector along it.
    index : float
        1 of a line of current, 2 of a line of dipoles.

    Returns
    -------
    OutputFit
        Unknowns (N, 6) are the point of each line that is nearest to the origin, metres, and the unit vector along it.
    """
    lines = Lines.of(points_m, weights, start, index)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # where a step leads far away
        own = solve_damped(lines.predict, data, lines.start(data, start), _is_small)
        unknowns, slopes = _nearest(own.unknowns)
        turn = np.kron(np.eye(2), lines.axes)
        slopes = turn @ slopes
        covariance = slopes @ own.covariance[:, :4, :4] @ np.swapaxes(slopes, 1, 2)
        solution = Solution((turn @ unknowns[..., None])[..., 0], covariance, own.chi_square, own.is_found)
        field = _field(np.zeros((len(data), 1, 3)), own.unknowns, index)[0].swapaxes(1, 2)
        predicted, derivative = lines.predict(own.unknowns, np.arange(len(data)))
    return OutputFit(solution, (lines.axes @ field)[..., 0], data - predicted, derivative)


@dataclass(frozen=True, eq=False)
class Lines:
    """Axes (N, 3, 3) of each sample in the array frame, as columns, and what is read along them.

    The third axis is nearly along the line. ``points_m`` (N, P, 3) and ``weights`` (N, 8, 3 P) are along them too.
    """

    axes: FloatArray
    points_m: FloatArray
    weights: FloatArray
    index: float

    @classmethod
    def of(cls, points_m: FloatArray, weights: FloatArray, start: FloatArray, index: float) -> "Lines":
        """Return what is read along the axes of each line to begin with (N, 6)."""
        along = start[:, 3:] / norm(start[:, 3:], axis=1, keepdims=True)
        first = np.cross(along, np.eye(3)[np.abs(along).argmin(axis=1)])
        first /= norm(first, axis=1, keepdims=True)
        axes = np.stack([first, np.cross(along, first), along], axis=2)
        return cls.seen_along(axes, points_m, weights, index)

    @classmethod
    def seen_along(cls, axes: FloatArray, points_m: FloatArray, weights: FloatArray, index: float) -> "Lines":
        """Return what an array with points (P, 3) and weights (N, 8, 3 P) in its own frame reads along some axes."""
        by_sensor = weights.reshape(*weights.shape[:2], -1, 3) @ axes[:, None]
        return cls(axes, points_m @ axes, by_sensor.reshape(weights.shape), index)

    def start(self, data: FloatArray, start: FloatArray) -> FloatArray:
        """Return unknowns (N, 5 or 6) whose strengths are found by linear least squares."""
        across = (np.swapaxes(self.axes, 1, 2) @ start[:, :3, None])[:, :2, 0]
        count = 1 if self.index == CURRENT_INDEX else 2
        tried = np.concatenate([across, np.zeros((len(data), 2)), np.ones((len(data), count))], axis=1)
        slopes = self.predict(tried, np.arange(len(data)))[1][..., 4:]
        scale = norm(slopes, axis=1)
        tried[:, 4:] = (np.linalg.pinv(slopes / scale[:, None]) @ data[..., None])[..., 0] / scale
        return tried

    def predict(self, unknowns: FloatArray, at: np.ndarray) -> tuple[FloatArray, FloatArray]:
        """Return the whitened outputs (n, 8) of some samples, and their derivatives by the unknowns."""
        field, slopes = _field(self.points_m[at], unknowns, self.index)
        weights, count = self.weights[at], len(at)
        data = (weights @ field.reshape(count, -1, 1))[..., 0]
        return data, weights @ slopes.reshape(count, -1, slopes.shape[-1])


def _field(points_m: FloatArray, unknowns: FloatArray, index: float) -> tuple[FloatArray, FloatArray]:
    """Return fields (n, P, 3) at points (n, P, 3), and their derivatives (n, P, 3, 5 or 6) by the unknowns."""
    place, along = _place_and_along(unknowns)
    offset, along, strength = points_m - place[:, None], along[:, None], unknowns[:, None, 4:, None]
    across = np.cross(along, offset)
    moved = [np.broadcast_to(np.cross(along, axis), across.shape) for axis in _ACROSS]
    tilted = [np.cross(axis, offset) for axis in _ACROSS]
    if index == CURRENT_INDEX:
        slopes = [strength[:, :, 0] * _slope(across, change) for change in [*(-each for each in moved), *tilted]]
        unit = across / _dot(across, across)
        return strength[:, :, 0] * unit, np.stack([*slopes, unit], axis=-1)
    moment = np.concatenate([strength[..., 0], np.zeros((len(unknowns), 1, 1))], axis=2)
    shift = np.cross(along, moment)
    by_place = [-_bend(across, shift, each) for each in moved]
    by_along = [
        _bend(across, shift, change) + _slope(across, np.cross(axis, moment))
        for change, axis in zip(tilted, _ACROSS, strict=True)
    ]
    by_moment = [_slope(across, each) for each in moved]
    return _slope(across, shift), np.stack([*by_place, *by_along, *by_moment], axis=-1)


def _place_and_along(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a point q (n, 3) of each line, and the vector T (n, 3) along it."""
    none = np.zeros((len(unknowns), 1))
    return np.concatenate([unknowns[:, :2], none], axis=1), np.concatenate([unknowns[:, 2:4], none + 1.0], axis=1)


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(np.sum(one * other, axis=-1, keepdims=True))


def _slope(vectors: FloatArray, change: FloatArray) -> FloatArray:
    """Return h'(c) u: the derivative of h along a change (…, 3)."""
    square = _dot(vectors, vectors)
    return (change - 2 * vectors * _dot(vectors, change) / square) / square


def _bend(vectors: FloatArray, one: FloatArray, other: FloatArray) -> FloatArray:
    """Return h''(c) u v: the second derivative of h along two changes (…, 3)."""
    square, by_one, by_other = _dot(vectors, vectors), _dot(vectors, one), _dot(vectors, other)
    along = vectors * (_dot(one, other) - 4 * by_one * by_other / square)
    return -2 * (one * by_other + other * by_one + along) / square**2


def _nearest(unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the nearest points and directions (N, 6) of lines, and their derivatives (N, 6, 4)."""
    place, along = _place_and_along(unknowns)
    length = norm(along, axis=1, keepdims=True)
    unit = along / length
    part = _dot(place, unit)
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    by_unit = -(unit[:, :, None] * place[:, None, :] + part[..., None] * np.eye(3))
    turned = across / length[..., None]
    by_place = np.concatenate([across, by_unit @ turned], axis=2)
    by_along = np.concatenate([np.zeros_like(turned), turned], axis=2)
    slopes = np.concatenate([by_place, by_along], axis=1)[..., [0, 1, 3, 4]]
    return np.concatenate([place - part * unit, unit], axis=1), slopes


def _is_small(unknowns: FloatArray, step: FloatArray) -> np.ndarray:
    """Return whether steps (N, 5 or 6) hardly change places, directions and strengths."""
    across, along, strength = (norm(each, axis=1) for each in np.split(step, (2, 4), axis=1))
    return np.asarray(
        (across <= _SMALLEST_STEP * norm(unknowns[:, :2], axis=1))
        & (along <= _SMALLEST_STEP)
        & (strength <= _SMALLEST_STEP * norm(unknowns[:, 4:], axis=1))
    )
