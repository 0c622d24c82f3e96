"""Readings of a sensor that belong to another sample: which they are, and how much energy that explains.

A sample counts as displaced where another sample's reading lowers its energy by more than the code length of the sample
and the displacement, 2 ln (N k), and leaves no more than noise reaches once in N samples. The
sensor is calibrated by the better half of the samples, so that the displaced ones do not tilt it.

A sensor is held against the field that all others measure. Such effects are simulated as bursts of samples that
something strikes at random times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_energy
from tam_calibration.core.normal_equations import ridged
from tam_calibration.effects.effect import Contribution, Finding, FittedEffect, WhitenedResiduals
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class AgainstOthers:
    """One sensor against the field that all others measure.

    Parameters
    ----------
    residuals : WhitenedResiduals
        Of all sensors.
    sensor : int
        Which one.
    beyond_T : (N, 3) array
        Residual: reading minus expected reading, tesla.
    expected_T : (N, 3) array
        Expected reading without bias, tesla.
    whitening : (3, 3) array
        ``beyond_T @ whitening`` has unit variance under the noise stated, that of the others included, 1/T.
    """

    residuals: WhitenedResiduals
    sensor: int
    beyond_T: FloatArray
    expected_T: FloatArray
    whitening: FloatArray

    @classmethod
    def of(cls, residuals: WhitenedResiduals, sensor: int) -> "AgainstOthers":
        """Return one sensor against the others, of which there must be one at least.

        Parameters
        ----------
        residuals : WhitenedResiduals
            Of all sensors.
        sensor : int
            Index of the one that is compared.
        """
        own = residuals.directions[3 * sensor : 3 * sensor + 3]
        information = ridged(own @ own.T)
        beyond = np.linalg.solve(information, own @ residuals.differential.T).T
        readings, bias = residuals.recording.readings_T[:, sensor], residuals.covariates.errors.bias_T[sensor]
        return cls(residuals, sensor, beyond, readings - bias - beyond, np.linalg.cholesky(information))

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """(N,) samples whose channels are told."""
        return self.residuals.channel_count > 0

    def energy(self, shift_T: FloatArray) -> FloatArray:
        """Return the energy (...) of shifts (..., 3) of its readings, in units of the noise stated."""
        return np.asarray(np.sum((shift_T @ self.whitening) ** 2, axis=-1))

    def floor(self, energy: FloatArray) -> float:
        """Return the robust variance of samples with energies (N,) of three axes, over that of the noise."""
        return noise_energy(energy[self.usable], 3)

    def recalibrated(self) -> "AgainstOthers":
        """Return the same at the bias and matrix that fit the better half of the samples best.

        By least trimmed squares (Rousseeuw, Least median of squares regression, J. Am. Stat. Assoc. 79, 1984), so that
        a minority of samples has no influence.
        """
        functions = np.column_stack([np.ones(len(self.usable)), self.expected_T / np.abs(self.expected_T).max()])
        usable = np.flatnonzero(self.usable)
        functions_of, beyond = functions[usable], self.beyond_T[usable]
        left = beyond
        for _ in range(8):  # concentration steps
            better = np.argpartition(self.energy(left), len(usable) // 2)[: len(usable) // 2 + 1]
            own = functions_of[better]
            values = np.linalg.lstsq(own.T @ own, own.T @ beyond[better], rcond=None)[0]
            left = beyond - functions_of @ values
        return replace(
            self, beyond_T=self.beyond_T - functions @ values, expected_T=self.expected_T + functions @ values
        )


def drawn_bursts(part: Contribution, sample_count: int, generator: np.random.Generator) -> tuple[NDArray[np.intp], int]:
    """Draw when bursts start; return their first samples, and how many samples each has.

    Parameters
    ----------
    part : Contribution
        With the ``rate``, the part of all samples that is struck, and the ``burst`` in samples, by default one.
    sample_count : int
        Of the run.
    generator : numpy.random.Generator
        Source of the random numbers.

    Raises
    ------
    InputError
        When the rate is no part, or the burst longer than the run.
    """
    rate, burst = part.values["rate"], samples_in(part, "burst", sample_count)
    if not 0 <= rate <= 1:
        raise InputError(f"the rate of {part.term} must be a part of all samples, 0 to 1, not {rate:g}")
    return np.flatnonzero(generator.random(sample_count) < rate / burst), burst


def samples_in(part: Contribution, name: str, sample_count: int) -> int:
    """Return a number of samples, at least and by default one, that a contribution states.

    Parameters
    ----------
    part : Contribution
        Of the effect.
    name : str
        Of the value.
    sample_count : int
        Of the run, which the number must not exceed.

    Raises
    ------
    InputError
        When it does, or is negative.
    """
    number = part.values.get(name, 1.0)
    if not 0 <= number <= sample_count:
        raise InputError(
            f"the {name} of {part.term} must be at most the {sample_count} samples of the run, not {number:g}"
        )
    return max(1, round(number))


NOWHERE_T = 1.0
"""An impossible displacement, for samples that cannot be displaced, tesla."""


def displaced(against: AgainstOthers, displacement_T: FloatArray) -> NDArray[np.intp]:
    """Return which displacement each sample (N,) of a sensor has, -1 for none.

    Parameters
    ----------
    against : AgainstOthers
        The sensor, calibrated by the better half of the samples.
    displacement_T : (k, N, 3) array
        Residual that each displacement would cause, tesla.
    """
    from scipy.special import chdtri

    energy = against.energy(against.beyond_T)
    floor, price = against.floor(energy), 2 * np.log(displacement_T[..., 0].size)
    samples = np.flatnonzero((energy > price * floor) & against.usable)
    left = against.energy(against.beyond_T[samples] - displacement_T[:, samples]) / floor
    best = np.argmin(left, axis=0)
    least = left[best, np.arange(len(samples))]
    claimed = (energy[samples] / floor - least > price) & (least < chdtri(3, 1 / len(energy)))
    which = np.full(len(energy), -1)
    which[samples[claimed]] = best[claimed]
    return which


@dataclass(frozen=True, eq=False)
class Explained:
    """Displaced samples (N,) of one sensor, its remaining residual (N, 3), tesla, and the parameters."""

    samples: NDArray[np.bool_]
    left_T: FloatArray
    contribution: Contribution


def finding_of(
    effect: str,
    residuals: WhitenedResiduals,
    found: Sequence[Explained],
    nats: float = 0.0,
    is_certain: bool = False,
) -> Finding:
    """Return the finding of displacements of several sensors together; their samples are excluded.

    Parameters
    ----------
    effect : str
        Its name.
    residuals : WhitenedResiduals
        Of all sensors.
    found : sequence of Explained
        Of the sensors that have the effect.
    nats : float
        Code length of the positions of the samples, where only the residual shows them.
    is_certain : bool
        See ``Finding``.
    """
    flagged = np.any([one.samples for one in found], axis=0)
    shift = np.zeros((len(flagged), len(residuals.directions)))
    for one in found:
        sensor = one.contribution.sensor
        shift[:, 3 * sensor : 3 * sensor + 3] = AgainstOthers.of(residuals, sensor).beyond_T - one.left_T
    saved = (residuals.energy - residuals.energy_without(shift))[residuals.is_counted | flagged].sum()
    fitted = FittedEffect(effect, {}, tuple(one.contribution for one in found))
    return Finding.of_samples(fitted, residuals, flagged, float(saved), len(found), nats, is_certain)


def bursts_of(struck: NDArray[np.bool_]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the part of the samples (N,) that are struck, how many follow each other, and standard errors, by name."""
    samples = np.flatnonzero(struck)
    rate, runs = len(samples) / len(struck), 1 + int(np.sum(np.diff(samples) > 1))
    error = float(np.sqrt(rate * (1 - rate) / len(struck)))
    return {"rate": rate, "burst": len(samples) / runs}, {"rate": error}


def position_nats(sample_count: int, chosen: int) -> float:
    """Return ln C(N, k), the code length of the flagged samples, in nats.

    Parameters
    ----------
    sample_count : int
        Number of samples N.
    chosen : int
        Number of flagged samples k.
    """
    from scipy.special import gammaln

    return float(gammaln(sample_count + 1) - gammaln(chosen + 1) - gammaln(sample_count - chosen + 1))
