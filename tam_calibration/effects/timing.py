"""Effects of sampling at another time: delays, jitter, and what is left of another channel's reading."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar
from weakref import WeakKeyDictionary

import numpy as np

from tam_calibration.effects.effect import Covariates, Finding, FoundEffect, LinearEffect, Shape, WhitenedResiduals
from tam_calibration.effects.laws import axis_terms, course_terms, scalar_term, sensor_terms
from tam_calibration.effects.motion import jumps, rates
from tam_calibration.effects.noise_excess import Spread
from tam_calibration.effects.states import WINDOW_UNITS, in_windows, windows_at
from tam_calibration.effects.term import Term, rows_of
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.units import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline


def _rates_of_rows(covariates: Covariates) -> FloatArray:
    """Return the rate (N, 3K) of what each axis senses, T/s."""
    return rates(covariates) @ covariates.errors.matrix.reshape(-1, 3).T


class TimeSkew(LinearEffect):
    """What is read was sensed a delay before: b(t - δ) = b - δ db/dt; uses samples on both sides."""

    name = "time_skew"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, where there is none."""
        return jumps(covariates)

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return delays of a sensor, of a single axis and of the scalar magnetometer.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            Not used: this effect has no shape parameters.
        """
        late, delay = -_rates_of_rows(covariates), {"delay": "s"}
        intensity_rate = np.sum(covariates.field_T * rates(covariates), axis=1) / covariates.intensity_T
        return [
            *sensor_terms(covariates, "delay", delay, late),
            *axis_terms(covariates, "delay of the axis", delay, late),
            scalar_term(covariates, "delay", delay, -intensity_rate[:, None]),
        ]


class TimingJitter(FoundEffect):
    """A scatter of the true times of sampling of one sensor about its stamps.

    A reading at t + δ differs by δ M db/dt: white noise with a variance for each sample, along the path of the field
    and growing with the square of its rate.
    """

    name = "timing_jitter"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, or no other sensor to tell it, where that is so."""
        if covariates.sensor_count == 1:
            return "one sensor alone does not tell how fast the field changed when it was read"
        return jumps(covariates)

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the sensor whose samples scatter along the path of the field and by how much, or why none does."""
        rate = _rates_of_rows(residuals.covariates)
        rows = [slice(3 * sensor, 3 * sensor + 3) for sensor in range(residuals.covariates.sensor_count)]
        found = [Spread.of(residuals, range(own.start, own.stop), rate[:, own, None]) for own in rows]
        sensor = int(np.argmax([one.gain for one in found]))
        best = found[sensor]
        if best.gain <= 0:
            return "no sensor scatters along the path of the field"
        spread = np.zeros((len(rate), rate.shape[1] + 1))
        spread[:, rows[sensor]] = best.size * rate[:, rows[sensor]]
        fitted = FittedEffect(self.name, {}, (best.contribution(sensor, None, "jitter"),))
        # Jitter has two numbers: its size, and the sensor.
        return Finding(fitted, best.gain, parameter_count=2, spread_T=spread)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        early = source.normal(0, part.values["standard deviation"], (len(rows_T), 1))
        return rows_T + early * _rates_of_rows(run)[:, rows_of(part, run)]


_LATE = ("late_x_s", "late_y_s", "late_z_s")
"""The delay of a channel that bleeds, by the axis of the array along which it reads."""

_KNOWN: "WeakKeyDictionary[Covariates, list[tuple[slice, CubicSpline]]]" = WeakKeyDictionary()


class Crosstalk(LinearEffect):
    """An axis reads a part of what another channel reads: of what one read before, or in windows of time.

    What always bleeds, and at once, is inside the calibration. All sensors read about the same field, so that a channel
    is told by the axis along which it reads. The noise that comes along is not modelled, and before the first sample
    the array is taken to have turned as evenly as then.
    """

    name = "crosstalk"
    shape_units: ClassVar[Mapping[str, str]] = dict.fromkeys(_LATE, "s") | WINDOW_UNITS

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return how late it is: from the previous channel to a queue of usual length; nothing without motion.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the delays follow from the time step.
        """
        if jumps(covariates) is not None:
            return []
        return [{name: steps * covariates.step_s} for name in _LATE for steps in (1.0, 2.0, 4.0, 7.0, 10.0)]

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> list[Shape]:
        """Return what bleeds at once from each axis in the windows: a gain, where all sensors read the same field."""
        windows = windows_at(times_s)
        return [{name: 0.0, **windows} for name in _LATE if windows]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return what each axis gets of the late channel: its change, or all of it in windows.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``late_x_s``, ``late_y_s`` or ``late_z_s``, the delay of that channel, and the limits of windows, seconds.
        """
        name = next((name for name in _LATE if name in shape), " or ".join(_LATE))
        late_s, source = shape[name], _LATE.index(name)
        bled = _change(covariates, source, late_s)
        if "on_1_s" in shape:
            bled = np.where(in_windows(covariates, shape), covariates.field_T[:, source] + bled, 0.0)
        return course_terms(covariates, f"from {'xyz'[source]}", {"bleed": "1"}, bled[:, None])


def _change(covariates: Covariates, axis: int, late_s: float) -> FloatArray:
    """Return the field (N,) along an axis so long before, less the present one."""
    time, change = covariates.time_s, np.zeros(covariates.sample_count)
    for stretch, course in _courses(covariates):
        before = time[stretch] - late_s
        past = np.where(before[:, None] < time[stretch.start], _turned_evenly(course, before), course(before))
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


def _turned_evenly(course: "CubicSpline", time_s: FloatArray) -> FloatArray:
    """Return the field (N, 3) of an array that turned evenly until a record begins."""
    begin = course.x[0]
    field, rate = course(begin), course(begin, 1)
    speed = max(float(np.linalg.norm(rate) / np.linalg.norm(field)), np.finfo(float).tiny)
    phase = speed * (time_s - begin)[:, None]
    return np.asarray(np.cos(phase) * field + np.sin(phase) * rate / speed)
