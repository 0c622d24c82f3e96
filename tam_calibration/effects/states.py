"""States in time: a bias, response or gain that changes at some times, once or again and again."""

from collections.abc import Iterable, Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.grades import MINOR
from tam_calibration.effects.recursions import relays
from tam_calibration.effects.term import axis_terms, course_terms, sensor_terms, turned
from tam_calibration.model.units import FloatArray

WINDOW_UNITS = {f"{edge}_{number}_s": "s" for number in range(1, 301) for edge in ("on", "off")}
"""SI units of the times of windows in a shape, of 300 windows at most; the last window may have no end."""

Times = tuple[tuple[float, ...], ...]
"""Times at which a law may come and go, seconds: those of each of several courses."""

MOST_STEPS = 3
"""Steps of one sensor's bias or scale, at most; what changes more often is a loose part or contact."""


class StateEffect(LinearEffect):
    """What comes and goes with a law, at the times at which that does."""

    is_free_in_time: ClassVar[bool] = True
    has_exact_shapes: ClassVar[bool] = True

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return no shape: those at the times of a law are tried."""
        return ()


class StepEffect(StateEffect):
    """What begins at a time, and may end at another."""

    is_step: ClassVar[bool] = True
    may_repeat: ClassVar[bool] = True
    shape_units: ClassVar[dict[str, str]] = {"time_s": "s", "end_s": "s"}

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> list[Shape]:
        """Return a step at each of a few times, and one that lasts from each to each later one."""
        if len(times_s) > MOST_STEPS:
            return []
        pairs = [(begin, end) for begin in times_s for end in times_s if begin < end]
        return [*({"time_s": time} for time in times_s), *({"time_s": begin, "end_s": end} for begin, end in pairs)]


class BiasJump(StepEffect):
    """Offsets of axes change at one time, for good or until another time."""

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return an offset of each row from the one time on, until the other where there is one.

        The shape has ``time_s`` of the jump and, where it ends, ``end_s``, seconds.
        """
        step = is_on(covariates.time_s, shape)[:, None].astype(float)
        return course_terms(covariates, "offset", {"offset": "T"}, step, with_scalar=True)


class ScaleStep(StepEffect):
    """The response of a sensor changes at one time, for good or until another time: it reads (M + ΔM) b."""

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return from the one time on a scale and a tilt of each axis and a turn of each sensor.

        The axes' scales and tilts together are any change of the response; what changes a scale amplifies the bias too.
        The shape has ``time_s`` of the step and, where it ends, ``end_s``, seconds.
        """
        since = is_on(covariates.time_s, shape)[:, None]
        terms = axis_terms(covariates, "scale", {"scale": "1"}, np.where(since, covariates.read_T, 0.0))
        sensed = np.where(since, covariates.sensed_T, 0.0)
        for row in range(covariates.scalar_row):
            others = [other for other in range(3) if other != row % 3]
            tilts = [Coefficient(f"tilt towards {'xyz'[other]}", "rad") for other in others]
            read = sensed[:, [row - row % 3 + other for other in others]]
            terms.append(Term.of_row(covariates, row, "tilt", tilts, read))
        turns = {f"turn about {axis}": "rad" for axis in "xyz"}
        field = np.where(since, covariates.field_T, 0.0)
        return terms + sensor_terms(covariates, "turn", turns, turned(covariates, field))


class GainSwitching(StateEffect):
    """The gain of an axis is another in windows of time, or while the reading is large."""

    shape_units: ClassVar[Mapping[str, str]] = (
        dict.fromkeys(("upper_T", "lower_T", "sensor_upper_T", "sensor_lower_T"), "T") | WINDOW_UNITS
    )
    """Thresholds of the size of an axis' reading, or of the largest of its sensor, or windows of time."""

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> list[Shape]:
        """Return the windows, where there are several, and the thresholds of an axis or a sensor that make them."""
        if len(times_s) < MOST_STEPS:
            return []
        sizes = np.abs(covariates.read_T)
        thresholds = [
            _thresholds(size, times_s, covariates, whose)
            for whose, of_whose in (("", sizes), ("sensor_", _largest(sizes)))
            for size in of_whose.T
        ]
        return [shape for shape in (windows_at(times_s), *thresholds) if shape]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the change of each axis' gain, by which the bias is amplified too.

        The shape has thresholds of the size of the reading, tesla, or the limits of windows, seconds.
        """
        return axis_terms(
            covariates, "gain", {"gain": "1"}, np.where(_states(covariates, shape), covariates.read_T, 0.0)
        )


def is_on(time_s: FloatArray, shape: Shape) -> NDArray[np.bool_]:
    """Return at which of (N,) times a step has begun and not ended."""
    return np.asarray((time_s >= shape["time_s"]) & (time_s < shape.get("end_s", np.inf)))


def windows_at(times_s: Sequence[float]) -> Shape:
    """Return the windows that begin and end in turn at some times; none where there are too many."""
    if len(times_s) > len(WINDOW_UNITS):
        return {}
    return dict(zip(WINDOW_UNITS, times_s, strict=False))


def in_windows(covariates: Covariates, shape: Shape) -> NDArray[np.bool_]:
    """Return whether each sample (N,) is in a window of a shape.

    Parameters
    ----------
    covariates : Covariates
        Times of the N samples.
    shape : Shape
        ``on_1_s``, ``off_1_s``, ``on_2_s``, ...: limits of the windows, seconds; a last one without ``off`` has no end.
    """
    times_s = [shape[name] for name in WINDOW_UNITS if name in shape]
    return np.asarray(np.searchsorted(times_s, covariates.time_s, side="right") % 2 == 1)


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
    """Return whether each row (N, 3K), or all rows (N, 1), have their other gain."""
    sizes, memory = np.abs(covariates.read_T), covariates.memory
    if "upper_T" in shape:
        return relays(sizes, shape["upper_T"], shape["lower_T"], memory)
    if "sensor_upper_T" in shape:
        return np.repeat(relays(_largest(sizes), shape["sensor_upper_T"], shape["sensor_lower_T"], memory), 3, axis=1)
    return in_windows(covariates, shape)[:, None]


def _largest(sizes: FloatArray) -> FloatArray:
    """Return the largest size (N, K) of each sensor's axes."""
    return np.asarray(sizes.reshape(len(sizes), -1, 3).max(axis=2))
