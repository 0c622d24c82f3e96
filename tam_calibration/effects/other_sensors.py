"""One sensor against the field that all others measure: its expected reading, and its residual."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_energy
from tam_calibration.core.normal_equations import ridged
from tam_calibration.effects.motion import rates
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.units import FloatArray

_CONCENTRATIONS = 8
"""Concentration steps of the least-trimmed-squares calibration."""


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
        usable: NDArray[np.bool_] = self.residuals.channel_count > 0
        return usable

    @cached_property
    def rate(self) -> FloatArray:
        """(N, 3) time derivative of the expected reading, T/s."""
        covariates, matrix = self.residuals.covariates, self.residuals.covariates.errors.matrix[self.sensor]
        field = np.linalg.solve(matrix, self.expected_T.T).T
        changing: FloatArray = rates(replace(covariates, field_T=field)) @ matrix.T
        return changing

    def energy(self, shift_T: FloatArray) -> FloatArray:
        """Return the energy (...) of shifts (..., 3) of its readings, in units of the noise stated."""
        energy: FloatArray = np.sum((shift_T @ self.whitening) ** 2, axis=-1)
        return energy

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
        for _ in range(_CONCENTRATIONS):
            better = np.argpartition(self.energy(left), len(usable) // 2)[: len(usable) // 2 + 1]
            own = functions_of[better]
            values = np.linalg.lstsq(own.T @ own, own.T @ beyond[better], rcond=None)[0]
            left = beyond - functions_of @ values
        return replace(
            self, beyond_T=self.beyond_T - functions @ values, expected_T=self.expected_T + functions @ values
        )
