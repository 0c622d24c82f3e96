"""Readings of one channel that bleed into another."""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.motion import jumps
from tam_calibration.effects.switching import WINDOW_UNITS, Level, Switching, in_windows, settled_strongest, windows_of
from tam_calibration.model.units import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_LATE = (1.0, 2.0, 4.0, 7.0, 10.0)
"""Delays of crosstalk, in sampling steps: from the previous channel to a queue of usual length."""

_SHAPES = {"late_x_s": 0, "late_y_s": 1, "late_z_s": 2}
"""Axis of the array along which the delayed channel reads, by the name of the delay parameter."""

_BLOCK = 16
"""Samples over which the response of a row is averaged: shorter than a window, long enough against noise."""

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
        """Return how late it is, where there is continuous motion, and the windows in which an axis bleeds most.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Of the same N samples.
        """
        is_continuous = jumps(covariates) is None
        late = [{name: steps * covariates.step_s} for name in _SHAPES for steps in _LATE if is_continuous]
        windows = _windows(covariates, residuals)
        on = {} if windows is None else windows.shape(covariates)
        return [*late, *({name: 0.0, **on} for name in _SHAPES if on)]

    def shapes_at(self, shape: Shape) -> list[Shape]:
        """Return what bleeds at once from each axis in the windows: a gain, where all sensors read the same field."""
        windows = windows_of(shape)
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


def _windows(covariates: Covariates, residuals: WhitenedResiduals) -> Switching | None:
    """Return the windows of the axis in which an intermittent response to the field explains most."""
    levels = [
        Level.of_row(residuals, row, covariates.field_T @ _bleeding(covariates, residuals, row))
        for row in range(covariates.scalar_row)
    ]
    states, level, _ = settled_strongest(levels)
    return states if level.is_switching(states) else None


def _bleeding(covariates: Covariates, residuals: WhitenedResiduals, row: int) -> FloatArray:
    """Return the intermittent response (3,) of a row to the field.

    The calibration absorbs the mean of the responses in blocks of time. Where one response is switched on and off, the
    responses of all blocks lie along one direction.
    """
    count = covariates.sample_count // _BLOCK
    blocks = slice(count * _BLOCK)
    field = (covariates.field_T[blocks] / np.median(covariates.intensity_T)).reshape(count, _BLOCK, 3)
    information = (residuals.is_counted * residuals.row_information[:, row])[blocks].reshape(count, _BLOCK, 1)
    shift = residuals.row_shift_T[blocks, row].reshape(count, _BLOCK)
    size = np.einsum("bni,bnj->bij", information * field, field)
    score = np.einsum("bni,bn->bi", information * field, shift)
    response = np.einsum("bij,bj->bi", np.linalg.pinv(size + size.mean(axis=0), hermitian=True), score)
    return np.linalg.eigh(response.T @ response)[1][:, -1]
