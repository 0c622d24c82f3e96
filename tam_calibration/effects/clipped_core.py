"""A core or amplifier that saturates before a factory correction, so that no reading repeats.

The correction mixes the axes and noise is added after it, so that no reading stays at one value. The residual is a
hinge function of the field: beyond a limit L along a direction u near an axis k the reading falls short along a
direction w, in proportion to the excess:

    residual = -w (u·b - L) where u·b > L,   with u_k w_k = 1, since beyond the limit the axis does not respond at all.

The unit slope, and a residual of no more than noise, distinguish it from any smooth nonlinearity.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.displaced import AgainstOthers
from tam_calibration.effects.grades import NOTABLE
from tam_calibration.effects.motion import is_chance
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.units import FloatArray

_ROUNDS = 5
"""Fits of the hinge to the samples beyond it; they converge in two or three."""

_SEARCH_DEPTH = 3.0
"""Depth from the end of an axis' range in which its limit is searched, over the largest shortfall."""


@dataclass(frozen=True, eq=False)
class ClippedCore:
    """Limits of a core.

    Parameters
    ----------
    sensor, axis : int
        Where.
    limits_T : dict
        Largest field that it can read, tesla, by "lower limit" and "upper limit", as far as they are reached.
    direction : (3,) array
        u, with 1 for the axis.
    fall : (3,) array
        w.
    samples : (F,) array of int
        Those beyond a limit.
    left_T : (N, 3) array
        Residual of the sensor's readings with the shortfall corrected, tesla.
    """

    sensor: int
    axis: int
    limits_T: dict[str, float]
    direction: FloatArray
    fall: FloatArray
    samples: NDArray[np.intp]
    left_T: FloatArray


def find_clipped_cores(residuals: WhitenedResiduals) -> list[ClippedCore]:
    """Return the cores that saturate; none for a single sensor, which has no reference."""
    count, found = residuals.covariates.sensor_count, []
    for sensor in range(count if count > 1 else 0):
        against = AgainstOthers.of(residuals, sensor).recalibrated()
        for axis in range(3):
            hinge = _Hinge(against, axis)
            core = hinge.fitted()
            if core is not None and not is_chance(hinge.saved_where, norm(against.rate, axis=1)):
                found.append(core)
    return found


@dataclass(frozen=True, eq=False)
class _Hinge:
    """The search for the limits of one axis."""

    against: AgainstOthers
    axis: int

    def saved_where(self, dealt: NDArray[np.intp]) -> float:
        """Return the energy that a hinge explains of permuted residuals, for a permutation test."""
        core = self.fitted(dealt)
        if core is None:
            return 0.0
        samples = core.samples
        return float(np.sum(self._energy[dealt[samples]] - self.against.energy(core.left_T[samples])))

    def fitted(self, dealt: NDArray[np.intp] | slice = slice(None)) -> ClippedCore | None:
        """Return the core whose hinge explains the residuals, permuted or as they are; None where there is none."""
        beyond_T, energy = self.against.beyond_T[dealt], self._energy[dealt]
        short = -self._end * beyond_T[:, self.axis]
        is_far = self.against.usable & (energy > 2 * np.log(len(short)) * self._floor)
        is_far &= (short > 0) & (short**2 * self._information > energy / 2) & (self._height > self._height.max() / 2)
        if is_far.sum() <= self._functions.shape[1]:
            return None
        is_near = self.against.usable & (self._height > self._height.max() - _SEARCH_DEPTH * short[is_far].max())
        beyond = is_far & is_near
        for _ in range(_ROUNDS):
            if beyond.sum() <= self._functions.shape[1]:
                return None
            values = self._plane(short, beyond)
            before, beyond = beyond, is_near & (self._shortfall(values) > 0)
            if (before == beyond).all():
                break
        if beyond.sum() <= self._functions.shape[1] or abs(values[self.axis] - 1) > NOTABLE:
            return None
        return self._core(values, np.flatnonzero(beyond), beyond_T)

    def _plane(self, short: FloatArray, chosen: NDArray[np.bool_]) -> FloatArray:
        """Return the plane (5,) fitted to the shortfall of chosen samples; NaN at an end that none reaches."""
        unit = np.append(np.full(3, self._height.max()), np.ones(2))
        values: FloatArray = np.linalg.lstsq(self._functions[chosen] / unit, short[chosen], rcond=None)[0] / unit
        is_reached = self._functions[chosen, 3:].any(axis=0)
        values[3:][~is_reached] = np.nan
        return values

    def _shortfall(self, values: FloatArray) -> FloatArray:
        """Return the shortfall (N,) of the samples for a plane, tesla; -inf at an end that none reaches."""
        short = self._functions @ np.where(np.isfinite(values), values, 0.0)
        short[self._functions[:, 3:][:, ~np.isfinite(values[3:])].any(axis=1)] = -np.inf
        return short

    def _core(self, values: FloatArray, samples: NDArray[np.intp], beyond_T: FloatArray) -> ClippedCore | None:
        """Return the core of a plane if its residual is no more than noise."""
        from scipy.special import chdtri

        shortfall = (self._end * (self._shortfall(values)))[samples]
        fall = -(shortfall @ beyond_T[samples]) / (shortfall @ shortfall)
        left = beyond_T.copy()
        left[samples] += shortfall[:, None] * fall
        noise = chdtri(3 * len(samples), 1 / len(left)) * self._floor
        if np.sum(self.against.energy(left[samples])) > noise:
            return None
        slope = values[self.axis]
        ends = zip(("upper limit", "lower limit"), (1, -1), values[3:], strict=True)
        limits = {name: float(-sign * value / slope) for name, sign, value in ends if np.isfinite(value)}
        return ClippedCore(self.against.sensor, self.axis, limits, values[:3] / slope, slope * fall, samples, left)

    @cached_property
    def _end(self) -> FloatArray:
        """(N,) 1 on the upper side of the axis, -1 on the lower."""
        return np.where(self.against.expected_T[:, self.axis] > 0, 1.0, -1.0)

    @cached_property
    def _height(self) -> FloatArray:
        """(N,) magnitude of the reading that is expected of the axis, tesla."""
        return np.abs(self.against.expected_T[:, self.axis])

    @cached_property
    def _functions(self) -> FloatArray:
        """(N, 5) regressors of the shortfall: the field outwards, and 1 at either end."""
        outward = self._end[:, None] * self.against.expected_T
        return np.column_stack([outward, self._end > 0, self._end < 0])

    @cached_property
    def _information(self) -> float:
        return float(np.sum(self.against.whitening[self.axis] ** 2))

    @cached_property
    def _energy(self) -> FloatArray:
        return self.against.energy(self.against.beyond_T)

    @cached_property
    def _floor(self) -> float:
        return self.against.floor(self._energy)
