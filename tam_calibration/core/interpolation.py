"""The reading of a sensor at a time between its readings: the cubic through three readings before and one after.

With u_k the times of the four readings less the time asked for, the value is Σ w_k y_k with Lagrange's weights
w_k = Π_{j≠k} u_j / (u_j - u_k). Times may be uneven. Only one reading after the time is needed, so that live a sample
is late by no more than one period. For even stamps h apart, and a field that turns at the rate ω, the error is at most
0.042 (ωh)⁴ of the field: 0.03 nT of 50 µT at 180°/s and 50 Hz, where the nearest reading is wrong by 1600 nT and a
straight line by 25 nT. The standard deviation of white noise is multiplied by √(Σ w_k²), which lies between 0.86 and
1.09 (Dahlquist and Björck, Numerical Methods in Scientific Computing I, SIAM, 2008, section 4.2, for the error).
"""

from dataclasses import replace
from functools import reduce
from itertools import permutations
from operator import and_
from typing import Any, TypeVar

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, IntArray

BEFORE = 3
"""Readings at or before the time that make a value; one more comes after it."""

MOST_UNEVEN = 8
"""Largest interval between the four readings over the smallest: where more are lost, the field is not known."""

LARGEST_ERROR = 0.042
"""Of even readings, over the field and (ωh)⁴: the largest of u_1 u_2 u_3 u_4 / 24 h⁴ between the last two readings."""

Number = TypeVar("Number", float, FloatArray)


def weights(first: Number, second: Number, third: Number, after: Number) -> tuple[Number, Number, Number, Number]:
    """Return Lagrange's weights of four readings at the time zero.

    Each is computed alike for numbers and arrays, to the last bit.

    Parameters
    ----------
    first, second, third, after : float or (n,) array
        Times of the readings less that asked for, rising, in any unit; the third is at most zero, the last above.

    Returns
    -------
    tuple of four float or (n,) array
        Their sum is 1.
    """
    return (
        second * third * after / ((second - first) * (third - first) * (after - first)),
        first * third * after / ((first - second) * (third - second) * (after - second)),
        first * second * after / ((first - third) * (second - third) * (after - third)),
        first * second * third / ((first - after) * (second - after) * (third - after)),
    )


def is_even(first: Number, second: Number, third: Number, after: Number) -> Any:
    """Return whether four readings lie evenly enough to make a value.

    Parameters
    ----------
    first, second, third, after : float or (n,) array
        As of ``weights``.

    Returns
    -------
    bool or (n,) array of bool
        Whether no interval is longer than ``MOST_UNEVEN`` times any other.
    """
    intervals = second - first, third - second, after - third
    return reduce(and_, (one <= MOST_UNEVEN * other for one, other in permutations(intervals, 2)))


def interpolated(times: IntArray, values: FloatArray, asked: IntArray) -> tuple[FloatArray, IntArray]:
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
    """
    after = np.searchsorted(times, asked, "right")
    inside = (after >= BEFORE) & (after < len(times))
    around = after[inside, None] + np.arange(-BEFORE, 1)
    relative = (times[around] - asked[inside, None]).astype(float).T
    even = is_even(*relative)
    inside[inside] = even
    told = np.full((len(asked), values.shape[1]), np.nan)
    parts = zip(weights(*relative[:, even]), around[even].T, strict=True)
    first, second, third, last = (weight[:, None] * values[index] for weight, index in parts)
    told[inside] = first + second + third + last
    return told, np.where(inside, after, len(times))


def without_delays(recording: Recording, delay_s: FloatArray) -> Recording:
    """Return a recording whose sensors were read later or earlier than its times say, brought to these times.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    delay_s : (K,) array
        How much later than it was read each sensor's reading is stamped, seconds.

    Returns
    -------
    Recording
        Without the samples at its ends, and beside gaps, of which the readings of a delayed sensor tell nothing.

    Raises
    ------
    InputError
        When no sample is left.
    """
    time_ns = np.round(1e9 * (recording.time_s - recording.time_s[0])).astype(np.int64)
    readings = recording.readings_T.copy()
    for sensor in np.flatnonzero(delay_s):
        sensed_ns = time_ns - np.int64(round(1e9 * delay_s[sensor]))
        readings[:, sensor] = interpolated(sensed_ns, recording.readings_T[:, sensor], time_ns)[0]
    is_told = np.isfinite(readings).all(axis=(1, 2))
    if not is_told.any():
        raise InputError("the delays of the sensors are longer than the recording, or its samples lie too unevenly")
    index = np.flatnonzero(is_told)
    return replace(recording.take(index), readings_T=readings[index])
