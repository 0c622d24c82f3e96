"""A gain that switches between two states."""

from collections.abc import Iterable
from itertools import product
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Memory
from tam_calibration.effects.effect import Covariates, LinearEffect, Shape
from tam_calibration.effects.switching import WINDOW_UNITS, Level, Switching, in_windows, settled_strongest, windows_of
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals
from tam_calibration.model.units import FloatArray

_QUANTILES, _COARSE = np.linspace(0, 1, 41), 8
"""Of the readings at which the gain changes, among which thresholds are sought; first every so many of them."""

_GAIN = Coefficient("gain", "1")


class GainSwitching(LinearEffect):
    """The gain of an axis is another in windows of time, or while the reading is large."""

    name = "gain_switching"
    shape_units: ClassVar[dict[str, str]] = {
        "upper_T": "T",
        "lower_T": "T",
        "sensor_upper_T": "T",
        "sensor_lower_T": "T",
    } | WINDOW_UNITS
    """Thresholds of the size of an axis' reading, or of the largest of its sensor, or windows of time."""

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the windows of the axis in which two states explain most, or the thresholds that make them.

        None where as much follows from the samples around each: what changes slowly is no switching.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Of the same N samples.
        """
        if self.obstacle(covariates):
            return []
        levels = [Level.of_row(residuals, row, covariates.sensed_T[:, row]) for row in range(covariates.scalar_row)]
        states, level, row = settled_strongest(levels)
        return [_shape(covariates, level, states, row)] if level.is_switching(states) else []

    def shapes_at(self, shape: Shape) -> list[Shape]:
        """Return the windows of the other effect, where it comes and goes more than once."""
        windows = windows_of(shape)
        return [windows] if "on_2_s" in windows else []

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


def _shape(covariates: Covariates, level: Level, states: Switching, row: int) -> Shape:
    """Return the thresholds that make the states, where some do as well for their number, or else the windows."""
    price = 2 * states.scale * np.log(covariates.sample_count)
    best, least = states.shape(covariates), states.gain - price * len(states.flips)
    size = _sizes(covariates)
    of_sensor = size[:, row // 3 * 3 : row // 3 * 3 + 3].max(axis=1)
    for own, names in ((size[:, row], ("upper_T", "lower_T")), (of_sensor, ("sensor_upper_T", "sensor_lower_T"))):
        thresholds, gain = _thresholds(own, level, states)
        if gain - 2 * price > least:
            best, least = dict(zip(names, thresholds, strict=True)), gain - 2 * price
    return best


def _thresholds(size: FloatArray, level: Level, states: Switching) -> tuple[tuple[float, float], float]:
    """Return the thresholds, among sizes at which states change, with which a relay explains most, and how much."""
    before, after = size[states.flips - 1], size[states.flips]
    rises = after > before
    if rises.all() or not rises.any():
        return (0.0, 0.0), 0.0
    uppers, lowers = (np.quantile((before + after)[which] / 2, _QUANTILES).tolist() for which in (rises, ~rises))

    def gain(thresholds: tuple[float, float]) -> float:
        return level.of(_relay(size, *thresholds)).gain

    best = max(product(uppers[::_COARSE], lowers[::_COARSE]), key=gain)
    best = max(((upper, best[1]) for upper in uppers), key=gain)
    best = max(((best[0], lower) for lower in lowers), key=gain)
    return best, gain(best)


def _states(covariates: Covariates, shape: Shape) -> NDArray[np.bool_]:
    """Return whether each row (N, 3K) has its other gain."""
    size = _sizes(covariates)
    if "upper_T" in shape:
        return np.column_stack([_relay(own, shape["upper_T"], shape["lower_T"], covariates.memory) for own in size.T])
    if "sensor_upper_T" in shape:
        largest = size.reshape(len(size), -1, 3).max(axis=2)
        thresholds = shape["sensor_upper_T"], shape["sensor_lower_T"]
        return np.repeat(np.column_stack([_relay(own, *thresholds, covariates.memory) for own in largest.T]), 3, axis=1)
    return np.broadcast_to(in_windows(covariates, shape)[:, None], size.shape)


def _sizes(covariates: Covariates) -> FloatArray:
    """Return the size (N, 3K) of the readings, on which an automatic gain depends."""
    return np.abs(covariates.sensed_T + covariates.errors.bias_T.ravel())


def _relay(size: FloatArray, upper: float, lower: float, memory: Memory | None = None) -> NDArray[np.bool_]:
    """Return whether a relay is on: from above the upper threshold on, until below the lower one; off at first."""
    before = None if memory is None else memory.recall()
    event = np.where(size > upper, 1, np.where(size < lower, -1, 0))
    last = np.maximum.accumulate(np.where(event != 0, np.arange(len(size)), -1))
    is_on: NDArray[np.bool_] = np.where(last < 0, bool(before), event[last] > 0)
    if memory is not None:
        memory.keep(bool(is_on[-1]))
    return is_on
