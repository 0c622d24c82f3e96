"""A reading that passes a filter which rings after fast changes."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import follow, mode
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.motion import jumps, rates
from tam_calibration.model.units import FloatArray

_FREQUENCIES, _DAMPINGS = 5, (0.1, 0.4)
"""Number of frequencies that are tried, and damping ratios; 1 no longer rings."""

_SLOWEST = 2.0
"""Ratio of the lowest frequency that is tried to that of the motion."""

_LOWEST_TAIL = 0.06
"""Cycles per sample of the slowest oscillation that is tried after jumps; a slower one does not end before the next."""

_PARTS = (Coefficient("amplitude", "1"), Coefficient("delay", "s"))
_TAIL = (Coefficient("tail", "1"), Coefficient("tail a quarter earlier", "1"))


class Ringing(LinearEffect):
    """A sensor reads b + a (h * b + (2ζ/ω) db/dt - b) - δ db/dt, with h the response of an oscillator of ω = 2πf and ζ.

    The delay of the filter, 2ζ/ω, is taken out of its response and has a value of its own, for time stamps may be
    corrected for it; samples on both sides are used. Where the field changes in jumps, as from pose to pose, each jump
    has a tail, an oscillation that dies, of any phase.
    """

    name = "ringing"

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return frequencies from above that of the motion to half the sampling rate, with little and much damping.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the frequencies follow from the motion.
        """
        highest = 0.5 / covariates.step_s
        lowest = {"tail_hz": _LOWEST_TAIL / covariates.step_s}
        if jumps(covariates) is None:
            lowest["frequency_hz"] = min(_SLOWEST * _motion_hz(covariates), highest / 2)
        return [
            {name: frequency, "damping": damping}
            for name in lowest
            for frequency in np.geomspace(lowest[name], highest, _FREQUENCIES).tolist()
            for damping in _DAMPINGS
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
            names, parts = _TAIL, np.stack([tail.real, tail.imag], axis=2)
        else:
            rate = rates(covariates)
            ringing = _response(covariates, shape["frequency_hz"], shape["damping"]) - covariates.field_T
            ringing += shape["damping"] / (np.pi * shape["frequency_hz"]) * rate
            names, parts = _PARTS, np.stack([ringing @ matrix.T, -rate @ matrix.T], axis=2)
        terms = []
        for sensor in range(covariates.sensor_count):
            rows, columns = np.divmod(np.arange(6), 2)
            features = parts[:, 3 * sensor : 3 * sensor + 3].reshape(-1, 6)
            terms.append(Term(sensor, None, "response", names, features, 3 * sensor + rows, columns))
        for row in range(covariates.scalar_row):
            terms.append(Term.of_row(covariates, row, "response of the axis", names, parts[:, row]))
        return terms


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
