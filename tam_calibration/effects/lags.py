"""Effects of the field before: delays, currents in conductors, filters that ring, and what another channel read."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import jumps
from tam_calibration.effects.effect import Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.recursions import follow, mode
from tam_calibration.effects.states import WINDOW_UNITS, in_windows, windows_at
from tam_calibration.effects.term import axis_terms, course_terms, matrix_terms, matrix_units, scalar_term, sensor_terms
from tam_calibration.model.units import FloatArray


class TimeSkew(LinearEffect):
    """What is read was sensed a delay before: b(t - δ) = b - δ db/dt; uses samples on both sides."""

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return delays of a sensor, of a single axis and of the scalar magnetometer."""
        late, delay = -covariates.sensed_rate_T_per_s, {"delay": "s"}
        intensity_rate = np.sum(covariates.field_T * covariates.rate_T_per_s, axis=1) / covariates.intensity_T
        return [
            *sensor_terms(covariates, "delay", delay, late),
            *axis_terms(covariates, "delay of the axis", delay, late),
            scalar_term(covariates, "delay", delay, -intensity_rate[:, None]),
        ]


SLOWER = 5.0
"""Ratio of the time constant of the slower mode of eddy currents to that of the first."""


class EddyCurrent(LinearEffect):
    """Changes of the field are shielded by C (b - b after a first-order lag); uses samples on both sides."""

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return time constants from part of a step of time to seconds.

        Currents that decay more slowly than the field turns change the scale factor, and a lag of it is a slow drift.
        """
        return [{"time_constant_s": constant} for constant in time_constants_s(covariates)]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return what each sensor gets of the currents, and of a second mode that decays more slowly.

        The shape has ``time_constant_s`` of the first mode, seconds.
        """
        constant = shape["time_constant_s"]
        late, later = followed(covariates, constant), followed(covariates, SLOWER * constant)
        return [
            *matrix_terms(covariates, "first mode", matrix_units("first mode"), covariates.field_T - late),
            *matrix_terms(covariates, "slower mode", matrix_units("slower mode"), late - later),
        ]


def time_constants_s(covariates: Covariates) -> list[float]:
    """Return the time constants to try, seconds: from part of a step of time to the time in which the field turns.

    Faster currents follow the field within a sample. The longest is 10 s, µ0 σ d²/π² of aluminium 1.5 m thick: nothing
    near a sensor is slower.

    Parameters
    ----------
    covariates : Covariates
        Time and field of the N samples.
    """
    shortest = 0.3 * covariates.step_s
    change = np.diff(covariates.field_T, axis=0)
    turning = np.sum(change**2) / np.sum(np.diff(covariates.time_s)) / covariates.step_s
    spread = np.mean(np.sum((covariates.field_T - covariates.field_T.mean(axis=0)) ** 2, axis=1))
    longest = max(min(10.0, float(np.sqrt(spread / turning))), 2 * shortest)
    constants: list[float] = np.geomspace(shortest, longest, 7).tolist()
    return constants


def followed(covariates: Covariates, tau: complex) -> NDArray[Any]:
    """Return x (N, 3) of x' = (b - x) / τ in the field b, tesla, settled anew behind every hole.

    Parameters
    ----------
    covariates : Covariates
        Time and field of the N samples.
    tau : complex
        Time constant, seconds; a complex one is that of an oscillation.
    """
    time, field, rate = covariates.time_s, covariates.field_T, covariates.rate_T_per_s
    return np.concatenate([mode(field[each], rate[each], time[each], tau) for each in covariates.stretches])


class Ringing(LinearEffect):
    """A sensor reads b + a (h * b + (2ζ/ω) db/dt - b) - δ db/dt, with h the response of an oscillator of ω = 2πf and ζ.

    The delay of the filter, 2ζ/ω, is taken out of its response and has a value of its own, for time stamps may be
    corrected for it; samples on both sides are used. Where the field changes in jumps, as from pose to pose, each jump
    has a tail, an oscillation that dies, of any phase.
    """

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return frequencies from above that of the motion to half the sampling rate, with little and much damping.

        Slower tails than 0.06 cycles per sample do not end before the next jump.
        """
        highest = 0.5 / covariates.step_s
        lowest = {"tail_hz": 0.06 / covariates.step_s}
        if jumps(covariates) is None:
            lowest["frequency_hz"] = min(2.0 * _motion_hz(covariates), highest / 2)
        return [
            {name: frequency, "damping": damping}
            for name in lowest
            for frequency in np.geomspace(lowest[name], highest, 5).tolist()
            for damping in (0.1, 0.4)
        ]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the response of a sensor and of a single axis, each with a delay, or the tails of its jumps.

        The shape has ``frequency_hz`` of the filter or ``tail_hz`` of the tails, hertz, and the ratio ``damping``.
        """
        matrix = covariates.errors.matrix.reshape(-1, 3)
        if "tail_hz" in shape:
            tail = _tail(covariates, shape["tail_hz"], shape["damping"]) @ matrix.T
            units, parts = {"tail": "1", "tail a quarter earlier": "1"}, (tail.real, tail.imag)
        else:
            rate = covariates.rate_T_per_s
            ringing = _response(covariates, shape["frequency_hz"], shape["damping"]) - covariates.field_T
            ringing += shape["damping"] / (np.pi * shape["frequency_hz"]) * rate
            units, parts = {"amplitude": "1", "delay": "s"}, (ringing @ matrix.T, -rate @ matrix.T)
        features = np.stack(parts, axis=2)
        return [
            *sensor_terms(covariates, "response", units, features),
            *axis_terms(covariates, "response of the axis", units, features),
        ]


def _pole(frequency_hz: float, damping: float) -> complex:
    return -2 * np.pi * frequency_hz * complex(damping, -np.sqrt(1 - damping**2))


def _response(covariates: Covariates, frequency_hz: float, damping: float) -> FloatArray:
    """Return the field (N, 3) after a second-order filter, settled anew behind every hole.

    With the pole p = -ω (ζ - i √(1 - ζ²)) it is -ω²/Im p Im(x/p) of the mode x' = p (x - b).
    """
    pole = _pole(frequency_hz, damping)
    return -((2 * np.pi * frequency_hz) ** 2) / pole.imag * np.imag(followed(covariates, -1 / pole) / pole)


def _tail(covariates: Covariates, frequency_hz: float, damping: float) -> NDArray[np.complexfloating]:
    """Return the tails of the field's jumps (N, 3): each begins with the jump, turns and dies; none behind a hole."""
    decay = -_pole(frequency_hz, damping) * covariates.step_s
    tail = np.zeros(covariates.field_T.shape, dtype=complex)
    for stretch in covariates.stretches:
        jump = np.diff(covariates.field_T[stretch], axis=0)
        tail[stretch] = follow(jump, np.zeros_like(jump), np.zeros(3), np.full((len(jump), 1), decay))
    return tail


def _motion_hz(covariates: Covariates) -> float:
    """Return the frequency of the motion: the size of the field's rate over that of its changes."""
    size = max(float(np.sqrt(np.mean(np.var(covariates.field_T, axis=0)))), np.finfo(float).tiny)
    return float(np.sqrt(np.mean(covariates.rate_T_per_s**2))) / size / (2 * np.pi)


_LATE = ("late_x_s", "late_y_s", "late_z_s")
"""The delay of a channel that bleeds, by the axis of the array along which it reads."""


class Crosstalk(LinearEffect):
    """An axis reads a part of what another channel reads: of what one read before, or in windows of time.

    What always bleeds, and at once, is inside the calibration. All sensors read about the same field, so that a channel
    is told by the axis along which it reads. The noise that comes along is not modelled, and before the first sample
    the array is taken to have turned as evenly as then.
    """

    shape_units: ClassVar[Mapping[str, str]] = dict.fromkeys(_LATE, "s") | WINDOW_UNITS

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return how late it is: from the previous channel to a queue of usual length; nothing without motion."""
        if jumps(covariates) is not None:
            return []
        return [{name: steps * covariates.step_s} for name in _LATE for steps in (1.0, 2.0, 4.0, 7.0, 10.0)]

    def shapes_at(self, times_s: Sequence[float], covariates: Covariates) -> list[Shape]:
        """Return what bleeds at once from each axis in the windows: a gain, where all sensors read the same field."""
        windows = windows_at(times_s)
        return [{name: 0.0, **windows} for name in _LATE if windows]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return what each axis gets of the late channel: its change, or all of it in windows.

        The shape has ``late_x_s``, ``late_y_s`` or ``late_z_s``, the delay of that channel, and the limits of windows.
        """
        name = next((name for name in _LATE if name in shape), " or ".join(_LATE))
        late_s, source = shape[name], _LATE.index(name)
        bled = _change(covariates, source, late_s)
        if "on_1_s" in shape:
            bled = np.where(in_windows(covariates, shape), covariates.field_T[:, source] + bled, 0.0)
        return course_terms(covariates, f"from {'xyz'[source]}", {"bleed": "1"}, bled[:, None])


def _change(covariates: Covariates, axis: int, late_s: float) -> FloatArray:
    """Return the field (N,) along an axis so long before, less the present one.

    Before a record begins the array turned evenly.
    """
    change = np.zeros(covariates.sample_count)
    for stretch, course in covariates.splines:
        time, begin = covariates.time_s[stretch] - late_s, course.x[0]
        field, rate = course(begin), course(begin, 1)
        speed = max(float(np.linalg.norm(rate) / np.linalg.norm(field)), np.finfo(float).tiny)
        phase = speed * (time - begin)
        turned = np.cos(phase) * field[axis] + np.sin(phase) * rate[axis] / speed
        past = np.where(time < begin, turned, course(time)[:, axis])
        change[stretch] = past - covariates.field_T[stretch, axis]
    return change
