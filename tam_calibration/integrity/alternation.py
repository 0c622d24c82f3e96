"""Sensors whose readings are those of two sensors in turn: two publishers that send on one topic."""

import numpy as np

from tam_calibration.integrity.fault import Fault, channel
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray

FEWEST = 50
"""Samples of which the ratio of the medians is 1 ± 0.14 for noise alone."""

ALTERNATES = 0.5
"""Median distance from the middle of the readings two samples away over that of the next ones: 1 for noise, 4 for a
smooth course; noise falls so low by 3.5 standard deviations of the fewest samples."""

REVERSES = -0.5
"""Median cosine of successive changes; noise has it too, a sensor that is read at half the rate has zero."""

_MOST = 4096
"""Samples in a row that are looked at: some tens of seconds."""


def alternating(source: SampleSource) -> list[Fault]:
    """Return the sensors whose readings lie nearer to those two samples away than to the next, where others' do not.

    Parameters
    ----------
    source : SampleSource
        Raw readings of K sensors, tesla.
    """
    block = next(iter(source.blocks()))
    readings_T = block.readings_T[:_MOST]
    if len(readings_T) < FEWEST or readings_T.shape[1] < 2:
        return []
    next_T, second_T = (_distance(readings_T, lag) for lag in (1, 2))
    is_alternating = (second_T < ALTERNATES * next_T) & (_cosine(readings_T) < REVERSES)
    if is_alternating.all():
        return []  # the array itself was turned to and fro
    time_s = float(block.time_s[0]), float(block.time_s[len(readings_T) - 1])
    return [
        Fault("alternating", sensor + 1, "", time_s, _sentence(sensor + 1, 1e9 * float(next_T[sensor])))
        for sensor in np.flatnonzero(is_alternating).tolist()
    ]


def _distance(readings_T: FloatArray, lag: int) -> FloatArray:
    """Return the median distance (K,) of readings from the middle of those some samples before and after, tesla."""
    middle_T = (readings_T[2 * lag :] + readings_T[: -2 * lag]) / 2
    distance_T: FloatArray = np.median(np.linalg.norm(readings_T[lag:-lag] - middle_T, axis=2), axis=0)
    return distance_T


def _cosine(readings_T: FloatArray) -> FloatArray:
    """Return the median cosine (K,) of each change and the next; zero where one of them is zero."""
    changes_T = np.diff(readings_T, axis=0)
    product = np.einsum("nki,nki->nk", changes_T[1:], changes_T[:-1])
    sizes = np.linalg.norm(changes_T[1:], axis=2) * np.linalg.norm(changes_T[:-1], axis=2)
    cosine: FloatArray = np.median(np.divide(product, sizes, out=np.zeros_like(product), where=sizes > 0), axis=0)
    return cosine


def _sentence(sensor: int, change_nT: float) -> str:
    return (
        f"the readings of {channel(sensor)} alternate from sample to sample between two courses {change_nT:.4g} nT "
        "apart, and those of the other sensors do not: two publishers send on its topic"
    )
