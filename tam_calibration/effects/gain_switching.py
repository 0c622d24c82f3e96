"""A gain that switches between two states."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Memory
from tam_calibration.effects.effect import Covariates, Shape
from tam_calibration.effects.grades import MINOR
from tam_calibration.effects.states import WINDOW_UNITS, StateEffect, in_windows, windows_at
from tam_calibration.effects.term import Coefficient, Term
from tam_calibration.model.units import FloatArray

_FEWEST_CHANGES = 3
"""Changes of a gain that goes to and fro; with fewer it is a step."""

_GAIN = Coefficient("gain", "1")


class GainSwitching(StateEffect):
    """The gain of an axis is another in windows of time, or while the reading is large."""

    name = "gain_switching"
    shape_units: ClassVar[dict[str, str]] = {
        "upper_T": "T",
        "lower_T": "T",
        "sensor_upper_T": "T",
        "sensor_lower_T": "T",
    } | WINDOW_UNITS
    """Thresholds of the size of an axis' reading, or of the largest of its sensor, or windows of time."""

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> list[Shape]:
        """Return the windows, where there are several, and the thresholds of an axis or a sensor that make them."""
        if len(times_s) < _FEWEST_CHANGES:
            return []
        sizes = _sizes(covariates)
        of_sensors = _largest(sizes)
        thresholds = [
            *(_thresholds(size, times_s, covariates, "") for size in sizes.T),
            *(_thresholds(size, times_s, covariates, "sensor_") for size in of_sensors.T),
        ]
        return [shape for shape in (windows_at(times_s), *thresholds) if shape]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the change of each axis' gain, by which the bias is amplified too.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            Thresholds of the size of the reading, tesla, or the limits of windows, seconds.
        """
        states = _states(covariates, shape)
        amplified = np.where(states, covariates.sensed_T + covariates.errors.bias_T.ravel(), 0.0)
        return [
            Term.of_row(covariates, row, "gain", [_GAIN], amplified[:, row, None])
            for row in range(covariates.scalar_row)
        ]


def _thresholds(size: FloatArray, times_s: Sequence[float], covariates: Covariates, whose: str) -> Shape:
    """Return the thresholds of a size (N,) at which a relay changes at some times; none where it does not explain them.

    The size rises above the upper one and falls below the lower one in turn.
    """
    flips = np.clip(np.searchsorted(covariates.time_s, times_s), 1, len(size) - 1)
    before, after = size[flips - 1], size[flips]
    rises = after > before
    if np.mean(rises[1:] != rises[:-1]) < 1 - MINOR:
        return {}
    upper, lower = (
        float(np.quantile(low, 1 - MINOR) + np.quantile(high, MINOR)) / 2
        for low, high in ((before[rises], after[rises]), (after[~rises], before[~rises]))
    )
    return {f"{whose}upper_T": upper, f"{whose}lower_T": lower} if upper >= lower else {}


def _states(covariates: Covariates, shape: Shape) -> NDArray[np.bool_]:
    """Return whether each row (N, 3K) has its other gain."""
    size = _sizes(covariates)
    if "upper_T" in shape:
        return np.column_stack([_relay(own, shape["upper_T"], shape["lower_T"], covariates.memory) for own in size.T])
    if "sensor_upper_T" in shape:
        thresholds = shape["sensor_upper_T"], shape["sensor_lower_T"]
        return np.repeat(
            np.column_stack([_relay(own, *thresholds, covariates.memory) for own in _largest(size).T]), 3, axis=1
        )
    return np.broadcast_to(in_windows(covariates, shape)[:, None], size.shape)


def _sizes(covariates: Covariates) -> FloatArray:
    """Return the size (N, 3K) of the readings, on which an automatic gain depends."""
    return np.abs(covariates.sensed_T + covariates.errors.bias_T.ravel())


def _largest(size: FloatArray) -> FloatArray:
    """Return the largest size (N, K) of each sensor's axes."""
    return np.asarray(size.reshape(len(size), -1, 3).max(axis=2))


def _relay(size: FloatArray, upper: float, lower: float, memory: Memory | None = None) -> NDArray[np.bool_]:
    """Return whether a relay is on: from above the upper threshold on, until below the lower one; off at first."""
    before = None if memory is None else memory.recall()
    event = np.where(size > upper, 1, np.where(size < lower, -1, 0))
    last = np.maximum.accumulate(np.where(event != 0, np.arange(len(size)), -1))
    is_on: NDArray[np.bool_] = np.where(last < 0, bool(before), event[last] > 0)
    if memory is not None:
        memory.keep(bool(is_on[-1]))
    return is_on
