"""The report on a calibration: one HTML page for the people who will rely on it, and a figure of the same residuals.

What every section of the report draws on is worked out once.
"""

from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import Coverage, measure_coverage
from tam_calibration.fit.identifiability import find_weakness
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import ResidualSeries, SensorErrors, residual_series
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report import blocks, page, recording_plots
from tam_calibration.report.calibration_rows import known_source_blocks, parameter_blocks, quality_blocks, update_blocks

_NO_GRADIENT = "The geometry of this array does not determine a gradient tensor, so there is no tensor residual."


class _View:
    """A calibration, the recording it came from, and what follows from the two.

    Residuals are those of the raw and of the corrected recording, what effects add taken off.
    """

    def __init__(self, calibration: Calibration, recording: Recording) -> None:
        self.calibration, self.recording = calibration, recording
        self.coverage = measure_coverage(calibration.correct(recording).outputs[:, :3])
        uncorrected = SensorErrors.none(calibration.errors.sensor_count)
        self.before = residual_series(uncorrected, calibration.array, recording, calibration.intensity_T)
        self.after = calibration.residuals(recording)
        known = calibration.reference or "the scalar reference"
        self.reference_name = known if calibration.has_scalar_reference else "the fitted constant intensity"

    def panels(self, series: ResidualSeries, color: str) -> dict[str, list[recording_plots.Panel]]:
        """Return the panels of the intensity, nT, and of the tensor where there is one, nT/m, by what they show."""
        floor = self.calibration.floor
        kinds = {f"|B| − {self.reference_name}": recording_plots.intensity_panels(series, floor, color)}
        if self.calibration.array.has_gradient:
            kinds["Tensor components"] = recording_plots.tensor_panels(series, floor, color)
        return kinds

    def plots(self) -> list[list[tuple[str, list[recording_plots.Panel], str]]]:
        """Return title, panels and unit of each kind of residual, before and after calibration."""
        states = {
            "before": self.panels(self.before, page.BEFORE_COLOR),
            "after": self.panels(self.after, page.AFTER_COLOR),
        }
        return [
            [(f"{what}, {state} calibration", kinds[what], unit) for state, kinds in states.items()]
            for what, unit in zip(states["before"], ("nT", "nT/m"), strict=False)
        ]


@page.in_style
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
    view = _View(calibration, recording)
    kinds = view.plots()
    heights = [*(recording_plots.height_inch(panels) for (_, panels, _), _ in kinds), 3.8]
    figure = page.new_figure(1.5 * page.PAGE_WIDTH_INCH, sum(heights))
    *rows, last = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    for row, plots in zip(rows, kinds, strict=True):
        for part, (title, panels, unit) in zip(row.subfigures(1, 2, squeeze=False)[0], plots, strict=True):
            part.suptitle(title)
            recording_plots.draw_over_time(part, recording.time_s, panels, unit)
    recording_plots.draw_coverage(last, view.coverage)
    return figure


def _verdict(calibration: Calibration) -> list[blocks.Block]:
    """Return whether the calibration can be relied on, and why it should be doubted."""
    quality = calibration.quality
    parts: list[blocks.Block] = [blocks.Text(f"{quality}.", "good" if quality.grade == "good" else "doubt")]
    if further := [blocks.sentence(reason) for reason in (*quality.reasons[1:], *calibration.notes)]:
        parts.append(blocks.Points(further))
    return parts


def _residuals(view: _View) -> list[blocks.Block]:
    """Return the residuals over time, before and after."""
    has_gradient = view.calibration.array.has_gradient
    introduction = (
        f"In a uniform field the length |B| of every corrected vector equals {view.reference_name}"
        f"{', and the gradient tensor is zero' if has_gradient else ''}; "
        "the rest is the residual. The dashed lines are ± one standard deviation of the noise floor, which no "
        "calibration can remove. Before and after are drawn to their own scales. "
        f"{recording_plots.thinning_note(view.recording.sample_count)}"
    )
    parts: list[blocks.Block] = [blocks.Text(introduction.strip())]
    time_s = view.recording.time_s
    for plots in view.plots():
        drawn = [(recording_plots.plot_over_time(time_s, panels, unit), title) for title, panels, unit in plots]
        parts.append(blocks.Gallery([page.embed(figure, f"{title}, over time", title) for figure, title in drawn]))
    return parts if has_gradient else [*parts, blocks.Text(_NO_GRADIENT)]


_INTRO = (
    "Residuals after calibration over their noise floor, on a logarithmic scale. A distribution that is wider than the "
    "dashed line, shifted or lopsided contains more than sensor noise. Samples beyond the axis count in the last bins."
)


def _histograms(view: _View) -> list[blocks.Block]:
    """Return how often the residuals have which size."""
    parts: list[blocks.Block] = [blocks.Text(_INTRO)]
    for what, panels in view.panels(view.after, page.AFTER_COLOR).items():
        drawn = [replace(panel, color=color) for panel, color in zip(panels, cycle(page.COLORS), strict=False)]
        label = f"{what}, after calibration"
        figure = recording_plots.plot_distributions(drawn, f"{label}, in noise floors")
        parts.append(page.embed(figure, f"Distributions: {label}", label))
    return parts


def _coverage(view: _View) -> list[blocks.Block]:
    """Return which directions of the field were visited."""
    picture = page.embed(
        recording_plots.plot_coverage(view.coverage),
        "Map of the directions of the field",
        "Direction of the field in the array frame, equal-area (Hammer) map: forward is +x, left +y, up +z.",
    )
    weakness = find_weakness(view.recording, view.calibration)
    doubts = [blocks.Text(str(weakness))] if weakness.parameters and view.calibration.update is None else []
    return [blocks.Text(_summary(view.coverage)), *doubts, picture]


def _summary(coverage: Coverage) -> str:
    seen = (
        f"The field visited {np.count_nonzero(coverage.counts)} of {len(coverage.counts)} cells of equal area "
        f"({100 * coverage.fraction:.0f} %)."
    )
    strength = "These directions do not determine every parameter."
    if np.isfinite(coverage.relative_error):
        size = blocks.number(coverage.relative_error)
        strength = f"The worst standard error is {size} × that of as many samples over the complete sphere."
    return f"{seen} {strength} {'' if coverage.enough else blocks.sentence(coverage.advice)}".strip()


def _parameters(calibration: Calibration) -> list[blocks.Block]:
    """Return the parameters with their standard errors."""
    parts = parameter_blocks(calibration)
    parts += [blocks.Text(statement) for statement in calibration.statements]
    if not calibration.array.has_gradient:
        parts.append(blocks.Text(f"The field at the centre is the mean of all sensors. {_NO_GRADIENT}"))
    return parts


def _provenance(calibration: Calibration) -> list[blocks.Block]:
    """Return where the calibration comes from."""
    first, last = calibration.time_span_s
    origin = [["recording", "not from a file"]]
    if (source := calibration.source) is not None:
        size = f"{blocks.count(source.size_bytes)} bytes"
        origin = [["recording", source.name], ["size", size], ["SHA-256", source.sha256]]
    rows = [
        *origin,
        ["samples", blocks.count(calibration.samples)],
        [
            "time",
            f"{blocks.fixed(first, 3)} s to {blocks.fixed(last, 3)} s, a span of {blocks.number(last - first, 4)} s",
        ],
        ["mean intensity", f"{blocks.fixed(to_nanotesla(calibration.intensity_T), 1)} nT"],
        ["reference", calibration.reference or ("scalar magnetometer" if calibration.has_scalar_reference else "none")],
        ["method", calibration.method],
        ["software", f"tam_calibration {__version__}"],
    ]
    places = calibration.array.positions_m.tolist()
    positions = [
        [str(sensor), *(blocks.fixed(value, 4) for value in place)] for sensor, place in enumerate(places, start=1)
    ]
    header = ["sensor", "x (m)", "y (m)", "z (m)"]
    caption = "Array: positions of the sensors, x forward, y left, z up."
    return [blocks.Table([], rows, numeric=False), blocks.Table(header, positions, caption)]


def write_calibration_report(path: Path, calibration: Calibration, recording: Recording) -> None:
    """Write a self-contained HTML page about a calibration and the recording that it came from.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    calibration : Calibration
        The estimate.
    recording : Recording
        The raw recording that it was made from.

    Raises
    ------
    InputError
        When the recording is not of the calibration's array, or the file cannot be written.
    """
    view = _View(calibration, recording)
    sections = [
        blocks.Section("Verdict", _verdict(calibration)),
        blocks.Section("Residuals over time", _residuals(view)),
        blocks.Section("Coverage of the sphere", _coverage(view)),
        blocks.Section("Distribution of the residuals", _histograms(view)),
        blocks.Section("Parameters", _parameters(calibration)),
        blocks.Section("Prior and data", update_blocks(calibration.update) if calibration.update else []),
        blocks.Section("Known source", known_source_blocks(calibration)),
        blocks.Section("Quality", quality_blocks(calibration)),
        blocks.Section("Provenance", _provenance(calibration)),
    ]
    name = [calibration.source.name] if calibration.source else []
    counts = blocks.counted(calibration.errors.sensor_count, "sensor"), f"{blocks.count(calibration.samples)} samples"
    page.write_page(path, "Calibration report", ", ".join([*name, *counts]), sections)
