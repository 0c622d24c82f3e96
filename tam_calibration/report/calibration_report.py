"""The report on a calibration: one HTML page for the people who will rely on it, and a figure of the same residuals.

What every section of the report draws on is worked out once.
"""

from dataclasses import replace
from itertools import cycle
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import Coverage, measure_coverage
from tam_calibration.fit.information import find_weakness
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import ResidualSeries, SensorErrors, residual_series
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report import recording_plots
from tam_calibration.report.blocks import Block, Gallery, Points, Section, Table, Text
from tam_calibration.report.calibration_rows import known_source_blocks, parameter_blocks, quality_blocks, update_blocks
from tam_calibration.report.formatting import count, counted, fixed, number, sentence
from tam_calibration.report.page import AFTER_COLOR, BEFORE_COLOR, COLORS, PAGE_WIDTH_INCH, STYLE, embed, write_page

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
        is_measured = calibration.has_scalar_reference
        self.reference_name = "the scalar reference" if is_measured else "the fitted constant intensity"

    def panels(self, series: ResidualSeries, color: str) -> dict[str, list[recording_plots.Panel]]:
        """Return the panels of the intensity, nT, and of the tensor where there is one, nT/m, by what they show."""
        floor = self.calibration.floor
        kinds = {f"|B| − {self.reference_name}": recording_plots.intensity_panels(series, floor, color)}
        if self.calibration.array.has_gradient:
            kinds["Tensor components"] = recording_plots.tensor_panels(series, floor, color)
        return kinds

    def plots(self) -> list[list[tuple[str, list[recording_plots.Panel], str]]]:
        """Return title, panels and unit of each kind of residual, before and after calibration."""
        states = {"before": self.panels(self.before, BEFORE_COLOR), "after": self.panels(self.after, AFTER_COLOR)}
        return [
            [(f"{what}, {state} calibration", kinds[what], unit) for state, kinds in states.items()]
            for what, unit in zip(states["before"], ("nT", "nT/m"), strict=False)
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
    view = _View(calibration, recording)
    kinds = view.plots()
    heights = [*(recording_plots.height_inch(panels) for (_, panels, _), _ in kinds), 3.8]
    figure = Figure(figsize=(1.5 * PAGE_WIDTH_INCH, sum(heights)), layout="constrained")
    *rows, last = figure.subfigures(len(heights), 1, squeeze=False, height_ratios=heights)[:, 0]
    for row, plots in zip(rows, kinds, strict=True):
        for part, (title, panels, unit) in zip(row.subfigures(1, 2, squeeze=False)[0], plots, strict=True):
            part.suptitle(title)
            recording_plots.draw_over_time(part, recording.time_s, panels, unit)
    recording_plots.draw_coverage(last, view.coverage)
    return figure


def _verdict(calibration: Calibration) -> list[Block]:
    """Return whether the calibration can be relied on, and why it should be doubted."""
    quality = calibration.quality
    blocks: list[Block] = [Text(f"{quality}.", "good" if quality.grade == "good" else "doubt")]
    if further := [sentence(reason) for reason in (*quality.reasons[1:], *calibration.notes)]:
        blocks.append(Points(further))
    if limits := _limits(calibration):
        blocks += [Text("What limits this verdict:"), Points(limits)]
    return blocks


def _limits(calibration: Calibration) -> list[str]:
    """Return what the calibration does not claim, however good it is."""
    limits = []
    if not calibration.has_scalar_reference:
        limits.append("There was no scalar reference: the absolute scale is unknown, and |B| is taken as constant.")
    if calibration.covariance is None:
        limits.append("The method gives no covariance: the standard errors of the parameters are unknown.")
    if calibration.held_out is None:
        limits.append("No samples were held out: the residuals are those of the samples that were fitted.")
    if calibration.noise_is_estimated:
        limits.append(
            "Not every noise was stated: the noise floor was estimated from this recording, and a residual near it "
            "proves less. State the noise in the array file to judge by it."
        )
    return limits


def _residuals(view: _View) -> list[Block]:
    """Return the residuals over time, before and after."""
    has_gradient = view.calibration.array.has_gradient
    introduction = (
        f"In a uniform field the length |B| of every corrected vector equals {view.reference_name}"
        f"{', and the gradient tensor is zero' if has_gradient else ''}; "
        "the rest is the residual. The dashed lines are ± one standard deviation of the noise floor, which no "
        "calibration can remove. Before and after are drawn to their own scales. "
        f"{recording_plots.thinning_note(view.recording.sample_count)}"
    )
    blocks: list[Block] = [Text(introduction.strip())]
    time_s = view.recording.time_s
    for plots in view.plots():
        drawn = [(recording_plots.plot_over_time(time_s, panels, unit), title) for title, panels, unit in plots]
        blocks.append(Gallery([embed(figure, f"{title}, over time", title) for figure, title in drawn]))
    return blocks if has_gradient else [*blocks, Text(_NO_GRADIENT)]


_INTRO = (
    "Residuals after calibration over their noise floor, on a logarithmic scale. A distribution that is wider than the "
    "dashed line, shifted or lopsided contains more than sensor noise. Samples beyond the axis count in the last bins."
)


def _histograms(view: _View) -> list[Block]:
    """Return how often the residuals have which size."""
    blocks: list[Block] = [Text(_INTRO)]
    for what, panels in view.panels(view.after, AFTER_COLOR).items():
        drawn = [replace(panel, color=color) for panel, color in zip(panels, cycle(COLORS), strict=False)]
        label = f"{what}, after calibration"
        figure = recording_plots.plot_distributions(drawn, f"{label}, in noise floors")
        blocks.append(embed(figure, f"Distributions: {label}", label))
    return blocks


def _coverage(view: _View) -> list[Block]:
    """Return which directions of the field were visited."""
    picture = embed(
        recording_plots.plot_coverage(view.coverage),
        "Map of the directions of the field",
        "Direction of the field in the array frame, equal-area (Hammer) map: forward is +x, left +y, up +z.",
    )
    weakness = find_weakness(view.recording, view.calibration)
    doubts = [Text(str(weakness))] if weakness.parameters and view.calibration.update is None else []
    return [Text(_summary(view.coverage)), *doubts, picture]


def _summary(coverage: Coverage) -> str:
    seen = (
        f"The field visited {np.count_nonzero(coverage.counts)} of {len(coverage.counts)} cells of equal area "
        f"({100 * coverage.fraction:.0f} %)."
    )
    strength = "These directions do not determine every parameter."
    if np.isfinite(coverage.relative_error):
        size = number(coverage.relative_error)
        strength = f"The worst standard error is {size} × that of as many samples over the complete sphere."
    return f"{seen} {strength} {'' if coverage.enough else sentence(coverage.advice)}".strip()


def _parameters(calibration: Calibration) -> list[Block]:
    """Return the parameters with their standard errors."""
    blocks = parameter_blocks(calibration)
    blocks += [Text(statement) for statement in calibration.statements]
    if not calibration.array.has_gradient:
        blocks.append(Text(f"The field at the centre is the mean of all sensors. {_NO_GRADIENT}"))
    return blocks


def _provenance(calibration: Calibration) -> list[Block]:
    """Return where the calibration comes from."""
    first, last = calibration.time_span_s
    origin = [["recording", "not from a file"]]
    if (source := calibration.source) is not None:
        size = f"{count(source.size_bytes)} bytes"
        origin = [["recording", source.name], ["size", size], ["SHA-256", source.sha256]]
    rows = [
        *origin,
        ["samples", count(calibration.samples)],
        ["time", f"{fixed(first, 3)} s to {fixed(last, 3)} s, a span of {number(last - first, 4)} s"],
        ["mean intensity", f"{fixed(to_nanotesla(calibration.intensity_T), 1)} nT"],
        ["reference", "scalar magnetometer" if calibration.has_scalar_reference else "none"],
        ["method", calibration.method],
        ["software", f"tam_calibration {__version__}"],
    ]
    places = calibration.array.positions_m.tolist()
    positions = [[str(sensor), *(fixed(value, 4) for value in place)] for sensor, place in enumerate(places, start=1)]
    header = ["sensor", "x (m)", "y (m)", "z (m)"]
    caption = "Array: positions of the sensors, x forward, y left, z up."
    return [Table([], rows, numeric=False), Table(header, positions, caption)]


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
        Section("Verdict", _verdict(calibration)),
        Section("Residuals over time", _residuals(view)),
        Section("Coverage of the sphere", _coverage(view)),
        Section("Distribution of the residuals", _histograms(view)),
        Section("Parameters", _parameters(calibration)),
        Section("Prior and data", update_blocks(calibration.update) if calibration.update else []),
        Section("Known source", known_source_blocks(calibration)),
        Section("Quality", quality_blocks(calibration)),
        Section("Provenance", _provenance(calibration)),
    ]
    name = [calibration.source.name] if calibration.source else []
    counts = counted(calibration.errors.sensor_count, "sensor"), f"{count(calibration.samples)} samples"
    write_page(path, "Calibration report", ", ".join([*name, *counts]), sections)
