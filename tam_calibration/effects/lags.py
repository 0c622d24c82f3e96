"""Effects of what answers the field with a lag: currents in conductors near a sensor, and filters that ring."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import follow, lagged_smooth, mode
from tam_calibration.effects.effect import Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.laws import axis_terms, matrix_terms, sensor_terms
from tam_calibration.effects.motion import jumps, rates
from tam_calibration.model.units import FloatArray

SLOWER = 5.0
"""Ratio of the time constant of the slower mode of eddy currents to that of the first."""


class EddyCurrent(LinearEffect):
    """Changes of the field are shielded by C (b - b after a first-order lag); uses samples on both sides."""

    name = "eddy_current"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, where there is none."""
        return jumps(covariates)

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return time constants from part of a step of time to seconds.

        Currents that decay more slowly than the field turns change the scale factor, and a lag of it is a slow drift.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the constants follow from the motion.
        """
        return [{"time_constant_s": constant} for constant in time_constants_s(covariates)]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return what each sensor gets of the currents, and of a second mode that decays more slowly.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_constant_s`` of the first mode, seconds.
        """
        constant = shape["time_constant_s"]
        late, later = followed(covariates, constant), followed(covariates, SLOWER * constant)
        return [
            *matrix_terms(covariates, "first mode", "first mode", covariates.field_T - late),
            *matrix_terms(covariates, "slower mode", "slower mode", late - later),
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


def followed(covariates: Covariates, time_constant_s: float) -> FloatArray:
    """Return the field (N, 3) after a first-order lag, tesla, settled anew behind every hole.

    Parameters
    ----------
    covariates : Covariates
        Time and field of the N samples.
    time_constant_s : float
        Of the lag, seconds.
    """
    field, rate = covariates.field_T, rates(covariates)
    parts = [
        lagged_smooth(field[stretch], rate[stretch], covariates.time_s[stretch], time_constant_s)
        for stretch in covariates.stretches
    ]
    return np.concatenate(parts)


class Ringing(LinearEffect):
    """A sensor reads b + a (h * b + (2ζ/ω) db/dt - b) - δ db/dt, with h the response of an oscillator of ω = 2πf and ζ.

    The delay of the filter, 2ζ/ω, is taken out of its response and has a value of its own, for time stamps may be
    corrected for it; samples on both sides are used. Where the field changes in jumps, as from pose to pose, each jump
    has a tail, an oscillation that dies, of any phase.
    """

    name = "ringing"

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return frequencies from above that of the motion to half the sampling rate, with little and much damping.

        Slower tails than 0.06 cycles per sample do not end before the next jump.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the frequencies follow from the motion.
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

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``frequency_hz`` of the filter or ``tail_hz`` of the tails, hertz, and the ratio ``damping``.
        """
        matrix = covariates.errors.matrix.reshape(-1, 3)
        if "tail_hz" in shape:
            tail = _tail(covariates, shape["tail_hz"], shape["damping"]) @ matrix.T
            units, parts = {"tail": "1", "tail a quarter earlier": "1"}, (tail.real, tail.imag)
        else:
            rate = rates(covariates)
            ringing = _response(covariates, shape["frequency_hz"], shape["damping"]) - covariates.field_T
            ringing += shape["damping"] / (np.pi * shape["frequency_hz"]) * rate
            units, parts = {"amplitude": "1", "delay": "s"}, (ringing @ matrix.T, -rate @ matrix.T)
        features = np.stack(parts, axis=2)
        return [
            *sensor_terms(covariates, "response", units, features),
            *axis_terms(covariates, "response of the axis", units, features),
        ]


def _response(covariates: Covariates, frequency_hz: float, damping: float) -> FloatArray:
    """Return the field (N, 3) after a second-order filter, settled anew behind every hole.

    With p = -ω (ζ - i √(1 - ζ²)) it is -ω²/Im p Im(x/p) of the mode x' = p (x - b).
    """
    omega = 2 * np.pi * frequency_hz
    pole = -omega * complex(damping, -np.sqrt(1 - damping**2))
    field, rate = covariates.field_T, rates(covariates)
    parts = [
        mode(field[stretch], rate[stretch], covariates.time_s[stretch], -1 / pole) for stretch in covariates.stretches
    ]
    return -(omega**2) / pole.imag * np.imag(np.concatenate(parts) / pole)


def _tail(covariates: Covariates, frequency_hz: float, damping: float) -> NDArray[np.complexfloating]:
    """Return the tails of the field's jumps (N, 3): each begins with the jump, turns and dies; none behind a hole."""
    turn = -2 * np.pi * frequency_hz * covariates.step_s * complex(damping, -np.sqrt(1 - damping**2))
    tail = np.zeros(covariates.field_T.shape, dtype=complex)
    for stretch in covariates.stretches:
        jump = np.diff(covariates.field_T[stretch], axis=0).astype(complex)
        tail[stretch] = follow(jump, np.zeros_like(jump), np.zeros(3, complex), np.full((len(jump), 1), -turn))
    return tail


def _motion_hz(covariates: Covariates) -> float:
    """Return the frequency of the motion: the size of the field's rate over that of its changes."""
    field = covariates.field_T - covariates.field_T.mean(axis=0)
    size = max(float(np.sqrt(np.mean(field**2))), np.finfo(float).tiny)
    return float(np.sqrt(np.mean(rates(covariates) ** 2))) / size / (2 * np.pi)
