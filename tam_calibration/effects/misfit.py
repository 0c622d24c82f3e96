"""What a model leaves of a recording."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.situation import Situation
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Misfit:
    """What a model leaves of a recording, for effects that are found in it otherwise than by regression.

    Parameters
    ----------
    recording : Recording
        As read.
    situation : Situation
        What the model knows of it.
    differential : (N, C) array
        Whitened residuals between the sensors, or against the field of the world, of unit variance under the model.
    directions : (3K, C) array
        How a shift of each row by one tesla moves them.
    common_mode : (N,) array
        Whitened residual of the scalar against the length of the field; NaN where there is no reference.
    row_slope : (N, 3K + 1) array
        How a shift of each row by one tesla moves the common mode.
    channel_count : (N,) array
        Number of whitened channels of each sample.
    is_counted : (N,) array of bool
        False where a sample was given up, as an outlier or as saturated.
    """

    recording: Recording
    situation: Situation
    differential: FloatArray
    directions: FloatArray
    common_mode: FloatArray
    row_slope: FloatArray
    channel_count: FloatArray
    is_counted: NDArray[np.bool_]

    @cached_property
    def energy(self) -> FloatArray:
        """(N,) sums of the squares of each sample's whitened channels."""
        energy: FloatArray = np.sum(self.differential**2, axis=1) + np.nan_to_num(self.common_mode) ** 2
        return energy

    @cached_property
    def row_information(self) -> FloatArray:
        """(N, 3K + 1) inverse variance with which a sample tells a shift of one row alone, 1/T²."""
        of_rows = np.append(np.sum(self.directions**2, axis=1), 0.0)
        has_reference = np.isfinite(self.common_mode)
        information: FloatArray = of_rows + has_reference[:, None] * self.row_slope**2
        return information

    @cached_property
    def row_shift_T(self) -> FloatArray:
        """(N, 3K + 1) the shift of one row alone that explains a sample best, tesla; 0 where nothing tells it."""
        score = np.nan_to_num(self.common_mode)[:, None] * self.row_slope
        score[:, :-1] += self.differential @ self.directions.T
        information = self.row_information
        shift: FloatArray = np.divide(score, information, out=np.zeros_like(score), where=information > 0)
        return shift

    def channels_without(self, shift_T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the channels, differential and common (N,), without shifts (N, 3K) of the readings, tesla.

        The common mode is 0 where there is no reference.
        """
        common = self.common_mode - np.sum(self.row_slope[:, :-1] * shift_T, axis=1)
        return self.differential - shift_T @ self.directions, np.nan_to_num(common)

    def energy_without(self, shift_T: FloatArray) -> FloatArray:
        """Return the energy (N,) that is left when shifts (N, 3K) are taken off the readings, tesla."""
        differential, common = self.channels_without(shift_T)
        energy: FloatArray = np.sum(differential**2, axis=1) + common**2
        return energy
