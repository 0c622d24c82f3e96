"""States in time: what begins at some time and may end, once or again and again."""

from collections.abc import Iterable, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.fitted_effect import Shape
from tam_calibration.model.units import FloatArray

_MOST_WINDOWS = 300
"""Windows at most."""

WINDOW_UNITS = {f"{edge}_{number}_s": "s" for number in range(1, _MOST_WINDOWS + 1) for edge in ("on", "off")}
"""SI units of the times of windows in a shape; the last window may have no end."""

Times = tuple[tuple[float, ...], ...]
"""Times at which a law may come and go, seconds: those of each of several courses."""

_MOST_STEPS = 3
"""Changes of a course whose steps are taken apart; what changes more often has windows."""


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
        if len(times_s) > _MOST_STEPS:
            return []
        pairs = [(begin, end) for begin in times_s for end in times_s if begin < end]
        return [*({"time_s": time} for time in times_s), *({"time_s": begin, "end_s": end} for begin, end in pairs)]


def is_on(time_s: FloatArray, shape: Shape) -> NDArray[np.bool_]:
    """Return at which of (N,) times a step has begun and not ended."""
    return np.asarray((time_s >= shape["time_s"]) & (time_s < shape.get("end_s", np.inf)))


def windows_at(times_s: Sequence[float]) -> Shape:
    """Return the windows that begin and end in turn at some times; none where there are too many."""
    if len(times_s) > 2 * _MOST_WINDOWS:
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
