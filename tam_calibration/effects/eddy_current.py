"""Eddy currents in conductors near a sensor."""

from collections.abc import Iterable

import numpy as np

from tam_calibration.effects.covariates import lagged_smooth
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.motion import jumps, rates
from tam_calibration.model.units import FloatArray

_SHORTEST = 0.3
"""Shortest time constant, in time steps: faster currents follow the field within a sample."""

_LONGEST_S = 10.0
"""Longest time constant, s: µ0 σ d²/π² of aluminium 1.5 m thick; nothing near a sensor is slower."""

_COUNT = 7
"""Time constants that are tried, close enough for a refinement."""

SLOWER = 5.0
"""Ratio of the time constant of the slower mode to that of the first."""


_NAMES = tuple(f"{axis} of the field on {row}" for row in "xyz" for axis in "xyz")


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
        columns = np.arange(9)
        terms = []
        late, later = followed(covariates, constant), followed(covariates, SLOWER * constant)
        for name, change in (("first mode", covariates.field_T - late), ("slower mode", late - later)):
            features = np.tile(change, 3)
            parts = tuple(Coefficient(f"{name}, {of}", "1") for of in _NAMES)
            for sensor in range(covariates.sensor_count):
                terms.append(Term(sensor, None, name, parts, features, 3 * sensor + columns // 3, columns))
        return terms


def time_constants_s(covariates: Covariates) -> list[float]:
    """Return the time constants to try, seconds: from part of a step of time to the time in which the field turns.

    Parameters
    ----------
    covariates : Covariates
        Time and field of the N samples.
    """
    shortest = _SHORTEST * covariates.step_s
    change = np.diff(covariates.field_T, axis=0)
    turning = np.sum(change**2) / np.sum(np.diff(covariates.time_s)) / covariates.step_s
    spread = np.mean(np.sum((covariates.field_T - covariates.field_T.mean(axis=0)) ** 2, axis=1))
    slowest = float(np.sqrt(spread / turning))
    longest = max(min(_LONGEST_S, slowest), 2 * shortest)
    constants: list[float] = np.geomspace(shortest, longest, _COUNT).tolist()
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
