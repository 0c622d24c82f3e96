"""The reading of a sensor at a time between its readings, with the noise of a reading: from four before and one after.

With u_k the times of the readings less the time asked for, the value is Σ w_k y_k. Lagrange's weights of the last
four readings, w_k = Π_{j≠k} u_j / (u_j - u_k), meet a cubic exactly, but change the variance of white noise by Σ w_k²,
between 0.75 and 1.18. All five readings leave a choice: w + α d meets it too, with d_k = Π_{j≠k} 1 / (u_k - u_j) the
weights of their fourth divided difference. The α is taken at which Σ w_k² = 1, or its least value where that is more
than 1, as near a gap. So a value has the noise of a reading, and so has the mean of many; of even readings two values
are correlated by less than 0.22. The standard errors of all that is computed from readings hold for values too.

Times may be uneven. Only one reading after the time is needed: live a sample is late by no more than one period. For
even stamps h apart, and a field that turns at the rate ω, the error is at most 0.049 (ωh)⁴ of the field: 0.04 nT of
50 µT at 180°/s and 50 Hz, where the nearest reading is wrong by 1600 nT and a straight line by 25 nT (Dahlquist and
Björck, Numerical Methods in Scientific Computing I, SIAM, 2008, section 4.2, for the error of the cubic).

Angular velocities come quicker than samples, and are averaged instead: see `AveragedRates`.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import sqrt
from typing import Any, TypeVar

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import LAGS, InterpolatedNoise, Recording
from tam_calibration.model.units import FloatArray, IntArray

BEFORE = 4
"""Readings at or before the time that make a value; one more comes after it."""

MOST_UNEVEN = 8
"""Largest interval between the five readings over the smallest: where more are lost, the field is not known."""

LARGEST_ERROR = 0.049
"""Of even readings, over the field and (ωh)⁴: the largest of u_2 u_3 u_4 u_5 / 24 h⁴ - α between the last two."""


Number = TypeVar("Number", float, FloatArray)
_Five = tuple[Number, Number, Number, Number, Number]


def weights(a: Number, b: Number, c: Number, d: Number, e: Number) -> _Five[Number]:
    """Return the weights of five readings that tell the value at the time zero.

    Numbers and arrays give the same result to the last bit.

    Parameters
    ----------
    a, b, c, d, e : float or (n,) array
        Times of the readings less that asked for, rising, in any unit; d is at most zero, e above.

    Returns
    -------
    tuple of five float or (n,) array
        Their sum is 1, and so is that of their squares, as long as the readings are nearly even.
    """
    a_b, a_c, a_d, a_e = b - a, c - a, d - a, e - a
    b_c, b_d, b_e = c - b, d - b, e - b
    c_d, c_e, d_e = d - c, e - c, e - d
    of_b, of_c, of_d, of_e = b_c * b_d * b_e, b_c * c_d * c_e, b_d * c_d * d_e, b_e * c_e * d_e
    before, behind = b * c, d * e
    cubic_b, cubic_c = c * behind / of_b, -b * behind / of_c
    cubic_d, cubic_e = before * e / of_d, -before * d / of_e
    change_a, change_b, change_c = 1 / (a_b * a_c * a_d * a_e), -1 / (a_b * of_b), 1 / (a_c * of_c)
    change_d, change_e = -1 / (a_d * of_d), 1 / (a_e * of_e)
    excess = cubic_b * cubic_b + cubic_c * cubic_c + cubic_d * cubic_d + cubic_e * cubic_e - 1
    product = cubic_b * change_b + cubic_c * change_c + cubic_d * change_d + cubic_e * change_e
    square = change_a * change_a + change_b * change_b + change_c * change_c + change_d * change_d + change_e * change_e
    part = -(product + _root(product * product - square * excess)) / square
    return (
        part * change_a,
        cubic_b + part * change_b,
        cubic_c + part * change_c,
        cubic_d + part * change_d,
        cubic_e + part * change_e,
    )


def _root(square: Any) -> Any:
    """Return the square root; 0 of what is negative."""
    return sqrt(max(square, 0.0)) if isinstance(square, float) else np.sqrt(np.maximum(square, 0.0))


def is_even(*times: Number) -> Any:
    """Return whether five readings lie evenly enough to make a value.

    Parameters
    ----------
    *times : float or (n,) array
        As of ``weights``.

    Returns
    -------
    bool or (n,) array of bool
        Whether no interval is longer than ``MOST_UNEVEN`` times any other.
    """
    intervals = [later - earlier for earlier, later in pairwise(times)]
    if isinstance(times[0], float):
        return max(intervals) <= MOST_UNEVEN * min(intervals)
    return np.max(intervals, axis=0) <= MOST_UNEVEN * np.min(intervals, axis=0)


class Correlation:
    """The correlation that white noise has after interpolation, summed up over values in the order of time.

    Where a sensor is read less often than it is asked for, every n-th value counts, so that there is one a reading.
    """

    def __init__(self) -> None:
        self._products, self._pairs = np.zeros(LAGS), np.zeros(LAGS)

    def add(self, after: IntArray, weight: FloatArray) -> None:
        """Add values, or some stretches of many.

        Parameters
        ----------
        after : (n,) array of int
            Number of the reading after each, not falling.
        weight : (n, 5) array
            The weights of the readings that make it.
        """
        if not len(after):
            return
        stride = max(round(len(after) / int(after[-1] - after[0] + 1)), 1)
        after, weight = after[::stride], weight[::stride]
        # 256 and 16: values that follow each other, and how many such stretches of a batch tell the correlation: to a
        # hundredth.
        length = min(len(after), 256)
        starts = np.linspace(0, len(after) - length, min(len(after) // length, 16)).astype(int)
        chosen = starts[:, None] + np.arange(length)
        after, weight = after[chosen], weight[chosen]
        for lag in range(1, min(LAGS, length - 1) + 1):
            apart = after[:, lag:] - after[:, :-lag]
            self._pairs[lag - 1] += apart.size
            for shift in range(BEFORE + 1):
                is_so = apart == shift
                earlier, later = weight[:, :-lag, shift:][is_so], weight[:, lag:, : BEFORE + 1 - shift][is_so]
                self._products[lag - 1] += np.sum(earlier * later)

    @property
    def values(self) -> FloatArray:
        """(LAGS,) correlation of values that lie so many apart; 0 where there is no pair."""
        return np.asarray(self._products / np.maximum(self._pairs, 1))


def interpolated(times: IntArray, values: FloatArray, asked: IntArray) -> tuple[FloatArray, IntArray, FloatArray]:
    """Return the values of a sensor at other times than those of its readings.

    Parameters
    ----------
    times : (n,) array of int
        Of the readings, rising, nanoseconds.
    values : (n, width) array
        The readings, in any unit.
    asked : (m,) array of int
        Other times, nanoseconds.

    Returns
    -------
    values : (m, width) array
        NaN where the readings tell none.
    after : (m,) array of int
        Place of the reading after each time; n where the readings tell none.
    weight : (t, 5) array
        Of the readings, at the times of which they tell.
    """
    after = np.searchsorted(times, asked, "right")
    inside = (after >= BEFORE) & (after < len(times))
    around = after[inside, None] + np.arange(-BEFORE, 1)
    relative = (times[around] - asked[inside, None]).astype(float).T
    even = is_even(*relative)
    inside[inside] = even
    found = np.full((len(asked), values.shape[1]), np.nan)
    weight = np.column_stack(weights(*relative[:, even]))
    oldest, first, second, third, last = (
        each[:, None] * values[index] for each, index in zip(weight.T, around[even].T, strict=True)
    )
    found[inside] = oldest + first + second + third + last
    return found, np.where(inside, after, len(times)), weight


def without_delays(recording: Recording, delay_s: FloatArray) -> Recording:
    """Return a recording whose sensors were read later or earlier than its times say, brought to these times.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    delay_s : (K,) or (K + 1,) array
        How much later than it was read a reading of each sensor, and of the scalar, is stamped, seconds.

    Returns
    -------
    Recording
        Without the samples at its ends, and near gaps, where the readings of a delayed sensor give no value.

    Raises
    ------
    InputError
        When no sample is left.
    """
    time_ns = np.round(1e9 * (recording.time_s - recording.time_s[0])).astype(np.int64)
    readings = recording.readings_T.copy()
    correlation = np.zeros((recording.sensor_count, LAGS))
    for sensor in np.flatnonzero(delay_s[: recording.sensor_count]):
        sensed_ns, own = time_ns - np.int64(round(1e9 * delay_s[sensor])), Correlation()
        readings[:, sensor], after, weight = interpolated(sensed_ns, recording.readings_T[:, sensor], time_ns)
        own.add(after[after < len(time_ns)], weight)
        correlation[sensor] = own.values
    is_told = np.isfinite(readings).all(axis=(1, 2))
    if not is_told.any():
        raise InputError("the delays of the sensors are longer than the recording, or its samples lie too unevenly")
    if recording.scalar_T is not None and delay_s[recording.sensor_count :].any():
        recording = replace(recording, scalar_T=_moved(recording.time_s, recording.scalar_T, delay_s[-1]))
    index = np.flatnonzero(is_told)
    noise = InterpolatedNoise(correlation, np.ones(recording.sensor_count))
    return replace(recording.take(index), readings_T=readings[index], interpolated_noise=noise)


def _moved(time_s: FloatArray, scalar_T: FloatArray, delay_s: float) -> FloatArray:
    """Return the scalar's readings at the samples next to their times less the delay; NaN elsewhere."""
    sensed_s = time_s - delay_s
    nearest = np.searchsorted((time_s[1:] + time_s[:-1]) / 2, sensed_s)
    joins = np.isfinite(scalar_T) & (np.abs(sensed_s - time_s[nearest]) <= np.diff(time_s).min(initial=np.inf) / 2)
    moved = np.full(len(time_s), np.nan)
    moved[nearest[joins]] = scalar_T[joins]
    return moved


class AveragedRates:
    """Angular velocities that come quicker than samples: their mean since the sample before, not the newest alone.

    Of the newest alone, noise and vibration between the samples would count as if they lasted until the next. A mean of
    M values over the time T is less than an angular velocity in its middle by (1 - 1/M²) T²/24 of its second
    derivative: that of the means before it is taken off, as a swing that reads a thousandth too small is a bias of the
    field.
    """

    def __init__(self) -> None:
        self._stamps_ns, self._rates = np.empty(0, dtype=np.int64), np.empty((0, 3))
        self._last_ns: int | None = None
        self._is_even = True
        self._before: tuple[Sequence[float], Sequence[float]] = ((np.nan,) * 3,) * 2

    def add(self, stamps_ns: IntArray | None, rates: FloatArray) -> None:
        """Take messages: their stamps (n,) and angular velocities (n, 3)."""
        if stamps_ns is None:
            self._is_even = False
            return
        known = np.isfinite(rates).all(axis=1)
        # Angular velocities that wait for a sample at most.
        most = 65_536
        self._stamps_ns = np.concatenate([self._stamps_ns, stamps_ns[known]])[-most:]
        self._rates = np.concatenate([self._rates, rates[known]])[-most:]

    def skips(self, stamp_ns: int, newest: Sequence[float]) -> bool:
        """Take the next sample without averaging if it has one message at most, and return whether it has.

        Then ``means`` would return the newest angular velocity, at more cost.

        Parameters
        ----------
        stamp_ns : int
            Of the sample.
        newest : (3,) sequence of float
            What joined it; NaN where nothing did.
        """
        if len(self._stamps_ns) > 1 or self._last_ns is None or stamp_ns <= self._last_ns:
            return False
        if len(self._stamps_ns) and self._stamps_ns[0] <= stamp_ns:
            self._stamps_ns, self._rates = self._stamps_ns[1:], self._rates[1:]
        self._last_ns, self._before = stamp_ns, (self._before[1], newest)
        return True

    def means(self, stamps_ns: IntArray, newest: FloatArray) -> FloatArray:
        """Return the angular velocities (n, 3) of samples, the newest ones where there are not several for one.

        Parameters
        ----------
        stamps_ns : (n,) array of int
            Of samples that follow each other.
        newest : (n, 3) array
            What joined them; NaN where nothing did.
        """
        edges = stamps_ns if self._last_ns is None else np.append(self._last_ns, stamps_ns)
        intervals = np.diff(edges)
        self._is_even &= bool((np.diff(self._stamps_ns) > 0).all()) and bool((intervals > 0).all())
        if not self._is_even or not len(intervals):
            self._last_ns = int(stamps_ns[-1])
            return newest
        usual_ns = int(np.median(intervals))
        before = stamps_ns[0] - usual_ns if self._last_ns is None else self._last_ns
        # Intervals of samples over which angular velocities are averaged at most: longer ones are gaps.
        begins = np.maximum(np.append(before, stamps_ns[:-1]), stamps_ns - int(1.5 * usual_ns))
        first, last = (np.searchsorted(self._stamps_ns, each, side="right") for each in (begins, stamps_ns))
        sums = np.vstack([np.zeros(3), np.cumsum(self._rates, axis=0)])
        count = np.maximum(last - first, 1)[:, None]
        means = np.where((count > 1) & np.isfinite(newest), (sums[last] - sums[first]) / count, newest)
        course = np.vstack([self._before, means])
        bend = (1 - 1 / count**2) / 24 * np.diff(course, 2, axis=0)
        self._last_ns, self._before = int(stamps_ns[-1]), (course[-2], course[-1])
        self._stamps_ns, self._rates = self._stamps_ns[last[-1] :], self._rates[last[-1] :]
        return np.where(np.isfinite(bend), means - bend, means)
