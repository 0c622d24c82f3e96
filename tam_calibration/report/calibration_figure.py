"""Figure of a calibration and a recording: residuals over time, before and after, and directions of the field.

What every section of the report draws on is worked out once.
"""

from dataclasses import dataclass

import matplotlib
from matplotlib.figure import Figure

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import Coverage, measure_coverage
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import ResidualSeries, residual_series
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.report import recording_plots
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, PAGE_WIDTH_INCH, STYLE

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
    field_T = calibration.correct(recording).outputs[:, :3]
    uncorrected = SensorErrors.none(calibration.errors.sensor_count)
    return CalibrationView(
        calibration,
        recording,
        measure_coverage(field_T),
        residual_series(uncorrected, calibration.array, recording, calibration.intensity_T),
        calibration.residuals(recording),
    )


@dataclass(frozen=True)
class ResidualPlot:
    """Residuals of one kind, before or after calibration: title, panels, and their unit."""

    title: str
    panels: list[recording_plots.Panel]
    unit: str


def residual_plots(view: CalibrationView) -> list[list[ResidualPlot]]:
    """Return the residuals of the intensity, and of the tensor where there is one, each before and after."""
    kinds = [(recording_plots.intensity_panels, "nT", f"|B| − {view.reference_name}")]
    if view.calibration.array.has_gradient:
        kinds.append((recording_plots.tensor_panels, "nT/m", "Tensor components"))
    states = (("before", BEFORE_COLOR, view.before), ("after", AFTER_COLOR, view.after))
    return [
        [
            ResidualPlot(f"{what}, {state} calibration", panels_of(series, view.calibration.floor, color), unit)
            for state, color, series in states
        ]
        for panels_of, unit, what in kinds
    ]


@matplotlib.rc_context(STYLE)
def plot_calibration(calibration: Calibration, recording: Recording) -> Figure:
    """Draw residuals over time, before (left) and after (right), and the directions of the field.

    Parameters
    ----------
    calibration : Calibration
        Of the recording's array.
    recording : Recording
        Raw readings.

    Raises
    ------
    InputError
        When the recording is not of the calibration's array.
    """
    view = view_of(calibration, recording)
    kinds = residual_plots(view)
    heights = [*(recording_plots.height_inch(before.panels) for before, _ in kinds), 3.8]
    figure = Figure(figsize=(1.5 * PAGE_WIDTH_INCH, sum(heights)), layout="constrained")
    *rows, last = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    for row, plots in zip(rows, kinds, strict=True):
        for part, plot in zip(row.subfigures(1, 2, squeeze=False)[0], plots, strict=True):
            part.suptitle(plot.title)
            recording_plots.draw_over_time(part, recording.time_s, plot.panels, plot.unit)
    recording_plots.draw_coverage(last, view.coverage)
    return figure
