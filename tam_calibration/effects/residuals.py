"""Whitened residuals of a model, places in them, and what is found there otherwise than by regression."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import ridged
from tam_calibration.effects.covariates import Covariates
from tam_calibration.model.fitted_effect import ALL, SCALAR, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class WhitenedResiduals:
    """Whitened residuals of a model, for effects that are found otherwise than by regression.

    Parameters
    ----------
    recording : Recording
        As read.
    covariates : Covariates
        Field and channels at each sample.
    differential : (N, C) array
        Whitened residuals between the sensors, or against the field of the world, of unit variance under the model.
    directions : (3K, C) array
        Their derivatives by a shift of each row, 1/T.
    common_mode : (N,) array
        Whitened residual of the scalar against the length of the field; NaN where there is no reference.
    row_slope : (N, 3K + 1) array
        Derivative of the common mode by a shift of each row, 1/T.
    channel_count : (N,) array
        Number of whitened channels of each sample.
    is_counted : (N,) array of bool
        False where a sample is excluded, as an outlier or as saturated.
    """

    recording: Recording
    covariates: Covariates
    differential: FloatArray
    directions: FloatArray
    common_mode: FloatArray
    row_slope: FloatArray
    channel_count: FloatArray
    is_counted: NDArray[np.bool_]

    @cached_property
    def energy(self) -> FloatArray:
        """(N,) sums of the squares of each sample's whitened channels."""
        return np.asarray(np.sum(self.differential**2, axis=1) + np.nan_to_num(self.common_mode) ** 2)

    @cached_property
    def row_information(self) -> FloatArray:
        """(N, 3K + 1) information of a sample on a shift of one row alone, 1/T²."""
        of_rows = np.append(np.sum(self.directions**2, axis=1), 0.0)
        has_reference = np.isfinite(self.common_mode)
        return of_rows + has_reference[:, None] * self.row_slope**2

    @cached_property
    def row_shift_T(self) -> FloatArray:
        """(N, 3K + 1) the shift of one row alone that explains a sample best, tesla; 0 without information."""
        score = np.nan_to_num(self.common_mode)[:, None] * self.row_slope
        score[:, :-1] += self.differential @ self.directions.T
        information = self.row_information
        return np.divide(score, information, out=np.zeros_like(score), where=information > 0)

    def energy_without(self, shift_T: FloatArray) -> FloatArray:
        """Return the residual energy (N,) after subtracting shifts (N, 3K) from the readings, tesla."""
        differential = self.differential - shift_T @ self.directions
        common_mode = self.common_mode - np.sum(self.row_slope[:, :-1] * shift_T, axis=1)
        return replace(self, differential=differential, common_mode=common_mode).energy

    @cached_property
    def row_deviations(self) -> FloatArray:
        """(N, 3K + 1) the shift of one row alone in its standard errors: its square is the energy it explains."""
        return self.row_shift_T * np.sqrt(self.row_information)

    def normal(self, samples: NDArray[np.intp], rows: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """Return the information (S, r, r), 1/T², and the score (S, r), 1/T, of shifts of some rows in each sample.

        Parameters
        ----------
        samples : (S,) array of int
            Indices of the chosen samples.
        rows : sequence of int
            Indices of the r rows.
        """
        chosen = np.array(rows)
        slope = self.row_slope[samples][:, chosen] * np.isfinite(self.common_mode[samples, None])
        own = np.vstack([self.directions, np.zeros((1, self.directions.shape[1]))])[chosen]
        information: FloatArray = own @ own.T + slope[:, :, None] * slope[:, None, :]
        return information, (self.row_shift_T[samples] * self.row_information[samples])[:, chosen]

    def explained_energy(self, samples: NDArray[np.intp], rows: Sequence[int]) -> FloatArray:
        """Return the energy (S,) of chosen samples that shifts of some rows explain, in each by their own amounts.

        Parameters
        ----------
        samples : (S,) array of int
            Indices of the chosen samples.
        rows : sequence of int
            Indices of the rows.
        """
        information, score = self.normal(samples, rows)
        return np.asarray(np.sum(score * np.linalg.solve(ridged(information), score[:, :, None])[:, :, 0], axis=1))


@dataclass(frozen=True)
class Place:
    """Some axes of a sensor, or the scalar magnetometer, or all sensors.

    Parameters
    ----------
    sensor : int
        Index of the sensor, or ``SCALAR`` or ``ALL``.
    rows : tuple of int
        Rows of a sample.
    """

    sensor: int
    rows: tuple[int, ...]

    def contribution_keys(self, is_whole: bool = True) -> tuple[tuple[int, int | None], ...]:
        """Return sensor and axis of each contribution: one without axis for a sensor as a whole, else one per axis."""
        if self.sensor in (SCALAR, ALL) or (is_whole and len(self.rows) == 3):
            return ((self.sensor, None),)
        return tuple((self.sensor, row % 3) for row in self.rows)


def places(sensor_count: int) -> list[Place]:
    """Return the scalar, and of every sensor each axis, each pair of axes and all three."""
    found = [Place(SCALAR, (3 * sensor_count,))]
    for sensor in range(sensor_count):
        axes = range(3 * sensor, 3 * sensor + 3)
        found += [Place(sensor, rows) for count in (1, 2, 3) for rows in combinations(axes, count)]
    return found


@dataclass(frozen=True, eq=False)
class Finding:
    """An effect that is found in a residual otherwise than by regression.

    Parameters
    ----------
    fitted : FittedEffect
        Where it was found, with its numbers.
    gain : float
        Twice the logarithm of the likelihood ratio against white noise of one free variance, at its best.
    parameter_count : int
        Number of free parameters, positions included.
    flagged : (N,) array of bool, optional
        Samples that cannot be used once it is known.
    variance : (3K + 1,) array, optional
        What it adds to the variance of each row, T².
    spread_T : (N, 3K + 1) array, optional
        The standard deviation of what it adds to the rows of each sample along one direction of its own, tesla.
    is_certain : bool
        Whether the readings prove it beyond chance, so that it precedes effects that explain as much.
    """

    fitted: FittedEffect
    gain: float
    parameter_count: int
    flagged: NDArray[np.bool_] | None = None
    variance: FloatArray | None = None
    spread_T: FloatArray | None = None
    is_certain: bool = False

    @property
    def is_variance(self) -> bool:
        """Whether it is a variance of every sample, which no reading proves."""
        return self.flagged is None and not self.is_certain and not (self.variance is None and self.spread_T is None)
