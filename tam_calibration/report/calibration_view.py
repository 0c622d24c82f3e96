"""What every section of a calibration report draws on, worked out once."""

from dataclasses import dataclass

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import Coverage, measure_coverage
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import ResidualSeries, residual_series
from tam_calibration.model.sensor_errors import SensorErrors

NO_GRADIENT = "The geometry of this array does not determine a gradient tensor, so there is no tensor residual."


@dataclass(frozen=True, eq=False)
class CalibrationView:
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
        Residuals of the raw and of the corrected recording, what effects add taken off.
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


def view_of(calibration: Calibration, recording: Recording) -> CalibrationView:
    """Work out residuals and coverage of a calibration.

    Parameters
    ----------
    calibration : Calibration
        The estimate that the report is about.
    recording : Recording
        The raw recording that it came from.

    Raises
    ------
    InputError
        When the recording is not of the calibration's array.
    """
    array, errors = calibration.array, calibration.errors
    field_T = calibration.correct(recording).outputs[:, :3]
    intensity_T = calibration.intensity_T
    return CalibrationView(
        calibration,
        recording,
        measure_coverage(field_T),
        residual_series(SensorErrors.none(errors.sensor_count), array, recording, intensity_T),
        residual_series(errors, array, calibration.without_effects(recording), intensity_T),
    )
