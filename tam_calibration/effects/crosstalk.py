"""Readings of one channel that bleed into another."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.motion import jumps
from tam_calibration.effects.states import WINDOW_UNITS, in_windows, windows_at
from tam_calibration.model.units import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_LATE = (1.0, 2.0, 4.0, 7.0, 10.0)
"""Delays of crosstalk, in sampling steps: from the previous channel to a queue of usual length."""

_SHAPES = {"late_x_s": 0, "late_y_s": 1, "late_z_s": 2}
"""Axis of the array along which the delayed channel reads, by the name of the delay parameter."""

_BLEED = Coefficient("bleed", "1")

_KNOWN: "WeakKeyDictionary[Covariates, list[tuple[slice, CubicSpline]]]" = WeakKeyDictionary()


class Crosstalk(LinearEffect):
    """An axis reads a part of what another channel reads: of what one read before, or in windows of time.

    What always bleeds, and at once, is inside the calibration. All sensors read about the same field, so that a channel
    is told by the axis along which it reads. The noise that comes along is not modelled, and before the first sample
    the array is taken to have turned as evenly as then.
    """

    name = "crosstalk"
    shape_units: ClassVar[Mapping[str, str]] = dict.fromkeys(_SHAPES, "s") | WINDOW_UNITS

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return how late it is, where there is continuous motion.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the delays follow from the time step.
        """
        if jumps(covariates) is not None:
            return []
        return [{name: steps * covariates.step_s} for name in _SHAPES for steps in _LATE]

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> list[Shape]:
        """Return what bleeds at once from each axis in the windows: a gain, where all sensors read the same field."""
        windows = windows_at(times_s)
        return [{name: 0.0, **windows} for name in _SHAPES if windows]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return what each axis gets of the late channel: its change, or all of it in windows.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``late_x_s``, ``late_y_s`` or ``late_z_s``, the delay of that channel, and the limits of windows, seconds.
        """
        name = next((name for name in _SHAPES if name in shape), " or ".join(_SHAPES))
        source = _SHAPES.get(name, 0)
        bled = _change(covariates, source, shape[name])
        if "on_1_s" in shape:
            bled = np.where(in_windows(covariates, shape), covariates.field_T[:, source] + bled, 0.0)
        return [
            Term.of_row(covariates, row, f"from {'xyz'[source]}", [_BLEED], bled[:, None])
            for row in range(covariates.scalar_row)
        ]


def _change(covariates: Covariates, axis: int, late_s: float) -> FloatArray:
    """Return the field (N,) along an axis so long before, less the present one."""
    time, change = covariates.time_s, np.zeros(covariates.sample_count)
    for stretch, course in _courses(covariates):
        before = time[stretch] - late_s
        past = np.where(before[:, None] < time[stretch.start], _turned(course, before), course(before))
        change[stretch] = (past - covariates.field_T[stretch])[:, axis]
    return change


def _courses(covariates: Covariates) -> "list[tuple[slice, CubicSpline]]":
    """Return the stretches of more than one sample, and the course of the field in each."""
    from scipy.interpolate import CubicSpline

    if covariates not in _KNOWN:
        stretches = [stretch for stretch in covariates.stretches if stretch.stop - stretch.start > 1]
        _KNOWN[covariates] = [
            (stretch, CubicSpline(covariates.time_s[stretch], covariates.field_T[stretch])) for stretch in stretches
        ]
    return _KNOWN[covariates]


def _turned(course: "CubicSpline", time_s: FloatArray) -> FloatArray:
    """Return the field (N, 3) of an array that turned evenly until a record begins."""
    begin = course.x[0]
    field, rate = course(begin), course(begin, 1)
    speed = max(float(np.linalg.norm(rate) / np.linalg.norm(field)), np.finfo(float).tiny)
    phase = speed * (time_s - begin)[:, None]
    return np.asarray(np.cos(phase) * field + np.sin(phase) * rate / speed)
