"""What every section of a calibration report draws on, worked out once."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.array import TENSOR_OUTPUTS, Array
from tam_calibration.calibration import Calibration
from tam_calibration.errors import SensorErrors
from tam_calibration.fit.coverage import Coverage, measure_coverage
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

NO_GRADIENT = "The geometry of this array does not determine a gradient tensor, so there is no tensor residual."


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """Residuals of every sample in a uniform field of known intensity.

    Parameters
    ----------
    sensor_intensity_T : (N, K) array
        |b_i| - s for each sensor, tesla; NaN where there is no reference.
    center_intensity_T : (N,) array
        The same for the centre vector, tesla.
    tensor_T_per_m : (N, 5) array
        Components xx, xy, xz, yy, yz, T/m; NaN where the geometry has no gradient.
    """

    sensor_intensity_T: FloatArray
    center_intensity_T: FloatArray
    tensor_T_per_m: FloatArray


@dataclass(frozen=True, eq=False)
class Evidence:
    """A calibration, the recording it came from, and what follows from the two.

    Parameters
    ----------
    calibration : Calibration
        The estimate that the report is about.
    recording : Recording
        The recording that it came from.
    coverage : Coverage
        Directions of the field in the array frame.
    before, after : ResidualSeries
        Residuals of the raw and of the corrected recording.
    """

    calibration: Calibration
    recording: Recording
    coverage: Coverage
    before: ResidualSeries
    after: ResidualSeries

    @property
    def reference_name(self) -> str:
        """What |B| is compared with."""
        return "the scalar reference" if self.calibration.has_scalar_reference else "the fitted constant intensity"


def gather(calibration: Calibration, recording: Recording, coverage: Coverage | None = None) -> Evidence:
    """Work out residuals, and the coverage where it is not given.

    Raises
    ------
    InputError
        When the recording is not of the calibration's array.
    """
    array, errors = calibration.array, calibration.errors
    field_T = calibration.correct(recording).outputs[:, :3]
    reference_T = _reference(calibration, recording)
    return Evidence(
        calibration,
        recording,
        coverage or measure_coverage(field_T),
        residual_series(SensorErrors.none(errors.sensor_count), array, recording, reference_T),
        residual_series(errors, array, recording, reference_T),
    )


def residual_series(
    errors: SensorErrors, array: Array, recording: Recording, reference_T: FloatArray
) -> ResidualSeries:
    """Return the residuals of each sample, corrected with given errors, against reference intensities (N,)."""
    corrected = errors.restore(recording.readings_T)
    outputs = corrected.reshape(len(corrected), -1) @ array.operator.T
    return ResidualSeries(
        norm(corrected, axis=2) - reference_T[:, None],
        norm(outputs[:, :3], axis=1) - reference_T,
        outputs[:, TENSOR_OUTPUTS],
    )


def _reference(calibration: Calibration, recording: Recording) -> FloatArray:
    if calibration.has_scalar_reference and recording.scalar_T is not None:
        return recording.scalar_T
    return np.full(recording.sample_count, calibration.intensity_T)
