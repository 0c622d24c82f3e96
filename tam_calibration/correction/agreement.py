"""Whether the corrected field is as long as the scalar magnetometer beside the array reads it."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.units import FloatArray, to_nanotesla

_DOUBTFUL_RATIO = 3.0
"""Residual over the noise floor, or over what the fit left, above which a new calibration is advised."""

_WRONG_PART = 0.01
"""Part of the intensity, some 500 nT: more in most samples is the calibration of another array, or another unit."""


@dataclass
class ScalarAgreement:
    """The residuals |B| − scalar of samples that have both.

    Parameters
    ----------
    samples : int
        How many there are.
    wrong : int
        Those whose residual exceeds a hundredth of the intensity.
    squares_T2 : float
        Sum of the squares of the residuals.
    """

    samples: int = 0
    wrong: int = 0
    squares_T2: float = 0.0

    def add(self, field_T: FloatArray, scalar_T: FloatArray) -> None:
        """Add samples.

        Parameters
        ----------
        field_T : (N, 3) array
            Corrected field at the centre, tesla; NaN where it is not determined.
        scalar_T : (N,) array
            Readings of the scalar magnetometer, tesla; NaN where there is none.
        """
        residual = np.linalg.norm(field_T, axis=1) - scalar_T
        is_known = np.isfinite(residual)
        self.samples += int(np.count_nonzero(is_known))
        self.wrong += int(np.count_nonzero(np.abs(residual[is_known]) > _WRONG_PART * scalar_T[is_known]))
        self.squares_T2 += float(np.sum(residual[is_known] ** 2))

    @property
    def residual_T(self) -> float:
        """Root mean square of the residuals, tesla; NaN where there is none."""
        return float(np.sqrt(self.squares_T2 / self.samples)) if self.samples else np.nan

    @property
    def is_wrong(self) -> bool:
        """Whether most samples are off by more than any use of this calibration makes them."""
        return 2 * self.wrong > self.samples

    def is_doubtful(self, calibration: Calibration) -> bool:
        """Whether the residual is larger than the calibration left it."""
        least_T = max(calibration.floor.center_intensity_T, calibration.in_sample.center_intensity_T)
        return self.residual_T > _DOUBTFUL_RATIO * least_T

    def sentence(self, calibration: Calibration) -> str:
        """Return the residual beside the noise floor, and what to do where they do not fit."""
        floor_nT = to_nanotesla(calibration.floor.center_intensity_T)
        compared = f"|B| − scalar is {to_nanotesla(self.residual_T):.3g} nT, noise floor {floor_nT:.3g} nT"
        if self.is_wrong:
            return f"{compared}: the calibration is not of this array, or a sensor or the scalar has another unit"
        return f"{compared}: calibrate again" if self.is_doubtful(calibration) else compared
