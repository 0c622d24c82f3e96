"""The readings of a survey line, turned into the world by the recorded attitude and thinned as the signal allows.

An error of the attitude turns the readings of all sensors together. So their mean tells the intensity and nothing else
(its direction is that of the regional field), and their differences tell the gradient. Both are free of the attitude's
error to first order in the source's field.
"""

from collections import deque
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.localization.line_path import Basis
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_BLOCK_M = 0.4
"""Way over which weak signals are averaged, metres: a target at 3 m changes its field over that by a percent."""

_CURVED = 0.04
"""What averaging over a block takes off the field of a target at 3 m, as a part of the differences between sensors."""

_FASTER = 2.0
"""Errors of the attitude that last less than the knots of its course, over those that last a sample."""

_ORDER = 5
"""Order of the differences in time that show the noise: of what sways within three seconds, at five samples a second,
they leave a hundredth."""

SMOOTH_M = 50.0
"""Distance between knots of what bends slowly along a line, the regional field's direction and its gradient, metres."""


@dataclass(frozen=True, eq=False)
class LineData:
    """M moments of a line with K sensors.

    Parameters
    ----------
    time_s : (M,) array
        Times, seconds.
    along_m : (M,) array
        Way along the line, metres.
    fields_T : (M, K, 3) array
        Readings in the world as the attitude reports it, tesla.
    arms_m : (M, K, 3) array
        From the array's centre to the sensors, in that world.
    noise_T : (M, K) array
        Standard deviation of the noise of each sensor's axes, tesla.
    direction : (M, 3) array
        Unit vectors along the regional field.
    attitude_error : float
        Standard deviation of the attitude's error about each axis, radians.
    white_attitude : (M,) array
        Part of it that is white, after averaging, radians.
    errors_T : (M, 3 K, Q) array
        What errors of the calibration of size one add to the readings in the world, tesla.
    """

    time_s: FloatArray
    along_m: FloatArray
    fields_T: FloatArray
    arms_m: FloatArray
    noise_T: FloatArray
    direction: FloatArray
    attitude_error: float
    white_attitude: FloatArray
    errors_T: FloatArray

    def take(self, at: np.ndarray) -> "LineData":
        """Return some of the moments."""
        by_moment = {name: value[at] for name, value in vars(self).items() if name != "attitude_error"}
        return replace(self, **by_moment)


def line_data(
    time_s: FloatArray,
    fields_T: FloatArray,
    attitude: FloatArray,
    array: Array,
    along_m: FloatArray,
    attitude_error: float,
    errors_T: FloatArray,
) -> LineData:
    """Return the readings of a line, averaged where they change slowly.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds.
    fields_T : (N, K, 3) array
        Calibrated readings, array frame, tesla.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    array : Array
        Places and noise of the sensors.
    along_m : (N,) array
        Way along the line, metres.
    attitude_error : float
        Standard deviation of the attitude about each axis, radians: the readings may show a larger one.
    errors_T : (N, 3 K, Q) array
        What errors of the calibration add to the readings, array frame, tesla.

    Raises
    ------
    Refused
        When there are too few samples.
    """
    if len(time_s) < 20:
        raise Refused(f"a line of {len(time_s)} samples is too short: record twenty or more")
    matrix = Rotation.from_quat(attitude).as_matrix()
    world = np.einsum("nij,nkj->nki", matrix, fields_T)
    arms = np.einsum("nij,kj->nki", matrix, array.positions_m)
    count, sensors = world.shape[:2]
    turned = np.einsum("nij,nkjq->nkiq", matrix, errors_T.reshape(count, sensors, 3, -1))
    noise = _noise(world, array)
    direction, wander, fast = _direction(world.mean(axis=1), along_m)
    error = max(attitude_error, wander)
    first, last, is_strong = _blocks(world, along_m, noise)
    sizes = np.where(is_strong, 1, last - first)
    middle = (first + last) // 2
    begin, end = np.where(is_strong, middle, first), np.where(is_strong, middle + 1, last)

    def averaged(values: FloatArray) -> FloatArray:
        total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
        return np.asarray((total[end] - total[begin]) / sizes.reshape(-1, *([1] * (values.ndim - 1))))

    base = world[0]
    return LineData(
        averaged(time_s - time_s[0]) + time_s[0],
        averaged(along_m),
        averaged(world - base) + base,
        averaged(arms),
        noise / np.sqrt(sizes)[:, None],
        direction[middle],
        error,
        np.maximum(min(_FASTER * fast, error) / np.sqrt(sizes), 1e-9),
        averaged(turned.reshape(count, 3 * sensors, -1)),
    )


def direction_wander(fields_T: FloatArray, attitude: FloatArray, along_m: FloatArray) -> float:
    """Return how far the direction of the field wanders about a smooth course in the world of an attitude, radians.

    Parameters
    ----------
    fields_T : (N, 3) array
        Field at the centre, array frame, tesla.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    along_m : (N,) array
        Way along the line, metres.
    """
    return _direction(Rotation.from_quat(attitude).apply(fields_T), along_m)[1]


def _noise(world: FloatArray, array: Array) -> FloatArray:
    """Return the noise (K,) of the sensors: as their differences show it from sample to sample, in the stated ratio."""
    stated = np.ones(array.sensor_count) if array.vector_noise_T is None else array.vector_noise_T
    weights = stated**-2 / np.sum(stated**-2)
    apart = world - np.einsum("nki,k->ni", world, weights)[:, None]
    jumps = np.diff(apart, _ORDER, axis=0) / np.sqrt(comb(2 * _ORDER, _ORDER))
    seen = np.median(np.abs(jumps), axis=(0, 2)) / 0.6745
    expected = np.sqrt(np.maximum(stated**2 - 1 / np.sum(stated**-2), 1e-12 * stated**2))
    ratio = float(np.sqrt(np.mean((seen / expected) ** 2)))
    return stated * ratio


def _direction(mean: FloatArray, along_m: FloatArray) -> tuple[FloatArray, float, float]:
    """Return the direction (N, 3) of the regional field, how far readings wander about it, and how fast, radians."""
    basis = Basis.over(float(along_m[0]), float(along_m[-1]), SMOOTH_M)
    rows = basis.matrix(along_m)
    unit = mean / norm(mean, axis=1, keepdims=True)
    weights = np.ones(len(unit))
    for _ in range(5):
        normal = (rows.T * weights) @ rows + 1e-9 * len(unit) * np.eye(rows.shape[1])
        smooth = rows @ np.linalg.solve(normal, (rows.T * weights) @ unit)
        away = norm(unit - smooth, axis=1)
        weights = 1 / np.maximum(away, np.median(away) + 1e-12)
    smooth /= norm(smooth, axis=1, keepdims=True)
    wander = float(np.median(away) / 1.1774)
    steps = norm(np.diff(unit, axis=0), axis=1)
    return smooth, wander, float(np.median(steps) / 1.1774 / np.sqrt(2.0))


def _blocks(world: FloatArray, along_m: FloatArray, noise: FloatArray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the first and last samples of blocks, and in which of them the signal is too strong to be averaged."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(along_m)))])
    number = np.floor(way / _BLOCK_M).astype(int)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    last = np.append(first[1:], len(number))
    apart = world - world.mean(axis=1, keepdims=True)
    size = norm((apart - np.median(apart, axis=0)).reshape(len(apart), -1), axis=1)
    strongest = np.maximum.reduceat(size, first)
    return first, last, _CURVED * strongest > 0.3 * float(noise.mean()) / np.sqrt(np.maximum(last - first, 1))


class SlidingLine:
    """Keeps the samples and the positions of the last seconds.

    Parameters
    ----------
    span_s : float
        Time that is kept, seconds.
    """

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._samples: deque[tuple[float, FloatArray, FloatArray, FloatArray]] = deque()
        self._positions: deque[tuple[float, FloatArray]] = deque()

    def push_sample(self, time_s: float, readings_T: FloatArray, attitude: FloatArray, rates: FloatArray) -> None:
        """Add a sample; a time that steps back starts a new line.

        Parameters
        ----------
        time_s : float
            Its time, seconds.
        readings_T : (K, 3) array
            Raw readings, tesla.
        attitude : (4,) array
            Quaternion x, y, z, w from the array frame to the world; NaN where it is not known.
        rates : (3,) array
            Angular velocity in the array frame, rad/s; NaN where it is not known.
        """
        if self._samples and time_s <= self._samples[-1][0]:
            self.clear()
        self._samples.append((time_s, readings_T, attitude, rates))
        while self._samples[0][0] < time_s - self._span_s:
            self._samples.popleft()

    def push_position(self, time_s: float, position_m: FloatArray) -> None:
        """Add a position (3,) of the array's centre in the world, metres."""
        if self._positions and time_s <= self._positions[-1][0]:
            self._positions.clear()
        self._positions.append((time_s, position_m))
        while self._positions[0][0] < time_s - self._span_s:
            self._positions.popleft()

    def clear(self) -> None:
        """Forget all."""
        self._samples.clear()
        self._positions.clear()

    def recording(self) -> Recording | None:
        """Return what is kept, with positions interpolated; None where there is no line of two positions."""
        if len(self._positions) < 2 or not self._samples:
            return None
        times, readings, attitudes, rates = (np.array(part) for part in zip(*self._samples, strict=True))
        known_s, known_m = (np.array(part) for part in zip(*self._positions, strict=True))
        position = np.column_stack([np.interp(times, known_s, each, np.nan, np.nan) for each in known_m.T])
        known = rates if np.isfinite(rates).any() else None
        return Recording(times, readings, attitude=attitudes, angular_velocity_rad_s=known, position_m=position)
