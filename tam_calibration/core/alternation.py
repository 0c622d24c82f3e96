"""Sensors whose readings are those of two sensors in turn: two publishers that send on one topic."""

import numpy as np

from tam_calibration.model.units import FloatArray, to_nanotesla

FEWEST = 50
"""Samples of which the ratio of the medians is 1 ± 0.14 for noise alone."""


def alternations(readings_T: FloatArray) -> dict[int, str]:
    """Return the sensors whose readings lie nearer to those two samples away than to the next, where others' do not.

    Parameters
    ----------
    readings_T : (N, K, 3) array
        Raw readings of K sensors, tesla, in the order of time.

    Returns
    -------
    dict of int to str
        Number of each such sensor, from 1, and what it does, in words.
    """
    # Samples in a row that are looked at: some tens of seconds.
    readings_T = readings_T[:4096]
    if len(readings_T) < FEWEST or readings_T.shape[1] < 2:
        return {}
    next_T, second_T = (_distance(readings_T, lag) for lag in (1, 2))
    # Median distance from the middle of the readings two samples away over that of the next ones: 1 for noise, 4
    # for a smooth course; noise falls so low by 3.5 standard deviations of the fewest samples.
    # Median cosine of successive changes; noise has it too, a sensor that is read at half the rate has zero.
    is_alternating = (second_T < 0.5 * next_T) & (_cosine(readings_T) < -0.5)
    if is_alternating.all():
        return {}  # the array itself was turned to and fro
    return {
        sensor + 1: (
            f"the readings of sensor {sensor + 1} alternate between two courses {to_nanotesla(next_T[sensor]):.4g} nT "
            "apart, and those of the other sensors do not, as where two publishers send on its topic"
        )
        for sensor in np.flatnonzero(is_alternating).tolist()
    }


def _distance(readings_T: FloatArray, lag: int) -> FloatArray:
    """Return the median distance (K,) of readings from the middle of those some samples before and after, tesla."""
    middle_T = (readings_T[2 * lag :] + readings_T[: -2 * lag]) / 2
    return np.asarray(np.median(np.linalg.norm(readings_T[lag:-lag] - middle_T, axis=2), axis=0))


def _cosine(readings_T: FloatArray) -> FloatArray:
    """Return the median cosine (K,) of each change and the next; zero where one of them is zero."""
    changes_T = np.diff(readings_T, axis=0)
    product = np.einsum("nki,nki->nk", changes_T[1:], changes_T[:-1])
    sizes = np.linalg.norm(changes_T[1:], axis=2) * np.linalg.norm(changes_T[:-1], axis=2)
    return np.asarray(np.median(np.divide(product, sizes, out=np.zeros_like(product), where=sizes > 0), axis=0))
