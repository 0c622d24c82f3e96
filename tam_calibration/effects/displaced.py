"""Readings of a sensor that belong to another sample: which they are, and how much energy that explains.

A sample counts as displaced where another sample's reading lowers its energy by more than the code length of the sample
and the displacement, 2 ln (N k), and leaves no more than noise reaches once in N samples. The
sensor is calibrated by the better half of the samples, so that the displaced ones do not tilt it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.effect import Finding
from tam_calibration.effects.motion import is_chance
from tam_calibration.effects.other_sensors import AgainstOthers
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.units import FloatArray

NOWHERE_T = 1.0
"""An impossible displacement, for samples that cannot be displaced, tesla."""

_MOST = 0.5
"""Part of the samples that may be displaced: more would be the sensor's usual behaviour."""


@dataclass(frozen=True, eq=False)
class Displaced:
    """A search for samples of one sensor that are displaced.

    Parameters
    ----------
    against : AgainstOthers
        The sensor, calibrated by the better half of the samples.
    beyond_T : (N, 3) array
        Residual of its readings, which is to be explained, tesla.
    displacement_T : (k, N, 3) array
        Residual that each displacement would cause, tesla; NaN where it is impossible.
    """

    against: AgainstOthers
    beyond_T: FloatArray
    displacement_T: FloatArray

    @cached_property
    def which(self) -> NDArray[np.intp]:
        """(N,) index of the displacement, -1 for none."""
        which = np.full(len(self.beyond_T), -1)
        samples, best, _ = self._claims(np.arange(len(which)))
        which[samples] = best
        return which

    @property
    def is_found(self) -> bool:
        """Whether some samples are displaced, significantly by a permutation test."""
        if not 0 < np.sum(self.which >= 0) < _MOST * len(self.which):
            return False
        return not is_chance(lambda dealt: float(np.sum(self._claims(dealt)[2])), norm(self.against.rate, axis=1))

    @cached_property
    def _energy(self) -> FloatArray:
        """(N,) energy of the readings as they are, in units of the noise of most of them."""
        energy = self.against.energy(self.beyond_T)
        return np.where(self.against.usable, energy / self._floor, 0.0)

    @cached_property
    def _floor(self) -> float:
        return self.against.floor(self.against.energy(self.beyond_T))

    def _claims(self, dealt: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]:
        """Return the displaced samples of permuted residuals, their displacements, and the energies explained."""
        from scipy.special import chdtri

        price = 2 * np.log(self.displacement_T[..., 0].size)
        samples = np.flatnonzero((self._energy[dealt] > price) & self.against.usable)
        shift = self.beyond_T[dealt[samples]] - self.displacement_T[:, samples]
        left = self.against.energy(shift) / self._floor
        best = np.argmin(left, axis=0)
        least = left[best, np.arange(len(samples))]
        saved = self._energy[dealt[samples]] - least
        claimed = (saved > price) & (least < chdtri(3, 1 / len(dealt)))
        return samples[claimed], best[claimed], saved[claimed]


@dataclass(frozen=True, eq=False)
class Explained:
    """Displaced samples (N,) of one sensor, its remaining residual (N, 3), tesla, and the parameters."""

    samples: NDArray[np.bool_]
    left_T: FloatArray
    contribution: Contribution


def finding_of(
    effect: str, residuals: WhitenedResiduals, found: Mapping[int, Explained], nats: float, is_certain: bool = False
) -> Finding:
    """Return the finding of displacements of several sensors together; their samples are excluded.

    Parameters
    ----------
    effect : str
    residuals : WhitenedResiduals
    found : mapping of int to Explained
        By sensor.
    nats : float
        Code length of the positions of the samples, where only the residual shows them.
    is_certain : bool
        See ``Finding``.
    """
    flagged = np.any([one.samples for one in found.values()], axis=0)
    shift = np.zeros((len(flagged), len(residuals.directions)))
    for sensor, one in found.items():
        shift[:, 3 * sensor : 3 * sensor + 3] = AgainstOthers.of(residuals, sensor).beyond_T - one.left_T
    used = residuals.is_counted | flagged
    count = float(residuals.channel_count[used].sum())
    return Finding(
        FittedEffect(effect, {}, tuple(one.contribution for one in found.values())),
        gain=count * float(np.log(residuals.energy[used].sum() / residuals.energy_without(shift)[used].sum())),
        parameter_count=len(found) + int(np.ceil(2 * nats / np.log(count))),
        flagged=flagged,
        is_certain=is_certain,
    )
