"""The report on a calibration: one HTML page for the people who will rely on it, section by section."""

from dataclasses import replace
from itertools import cycle
from pathlib import Path

import numpy as np

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.coverage import Coverage
from tam_calibration.fit.identifiability import find_weakness
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import to_nanotesla
from tam_calibration.report import calibration_figure, recording_plots
from tam_calibration.report.blocks import Block, Gallery, Image, Points, Section, Table, Text
from tam_calibration.report.calibration_rows import known_source_blocks, parameter_blocks, quality_blocks, update_blocks
from tam_calibration.report.formatting import count, fixed, number, sentence
from tam_calibration.report.page import embed, write_page
from tam_calibration.report.style import COLORS


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


def _residuals(evidence: calibration_figure.CalibrationView) -> list[Block]:
    """Return the residuals over time, before and after."""
    blocks: list[Block] = [Text(_introduce(evidence))]
    blocks += [
        Gallery([_over_time(evidence, plot) for plot in plots]) for plots in calibration_figure.residual_plots(evidence)
    ]
    if not evidence.calibration.array.has_gradient:
        blocks.append(Text(calibration_figure.NO_GRADIENT))
    return blocks


def _over_time(evidence: calibration_figure.CalibrationView, plot: calibration_figure.ResidualPlot) -> Image:
    figure = recording_plots.plot_over_time(evidence.recording.time_s, plot.panels, plot.unit)
    return embed(figure, f"{plot.title}, over time", plot.title)


def _introduce(evidence: calibration_figure.CalibrationView) -> str:
    tensor = ", and the gradient tensor is zero" if evidence.calibration.array.has_gradient else ""
    return (
        f"In a uniform field the length |B| of every corrected vector equals {evidence.reference_name}{tensor}; "
        "the rest is the residual. The dashed lines are ± one standard deviation of the noise floor, which no "
        "calibration can remove. Before and after are drawn to their own scales. "
        f"{recording_plots.thinning_note(evidence.recording.sample_count)}"
    ).strip()


_INTRO = (
    "Residuals after calibration over their noise floor, on a logarithmic scale. A distribution that is wider than the "
    "dashed line, shifted or lopsided contains more than sensor noise. Samples beyond the axis count in the last bins."
)


def _histograms(evidence: calibration_figure.CalibrationView) -> list[Block]:
    """Return how often the residuals have which size."""
    floor = evidence.calibration.floor
    kinds = {f"|B| − {evidence.reference_name}": recording_plots.intensity_panels(evidence.after, floor)}
    if evidence.calibration.array.has_gradient:
        kinds["Tensor components"] = recording_plots.tensor_panels(evidence.after, floor)
    blocks: list[Block] = [Text(_INTRO)]
    for what, panels in kinds.items():
        drawn = [replace(panel, color=color) for panel, color in zip(panels, cycle(COLORS), strict=False)]
        label = f"{what}, after calibration"
        blocks.append(
            embed(
                recording_plots.plot_distributions(drawn, f"{label}, in noise floors"), f"Distributions: {label}", label
            )
        )
    return blocks


def _coverage(evidence: calibration_figure.CalibrationView) -> list[Block]:
    """Return which directions of the field were visited."""
    picture = embed(
        recording_plots.plot_coverage(evidence.coverage),
        "Map of the directions of the field",
        "Direction of the field in the array frame, equal-area (Hammer) map: forward is +x, left +y, up +z.",
    )
    weakness = find_weakness(evidence.recording, evidence.calibration)
    doubts = [Text(str(weakness))] if weakness.parameters and evidence.calibration.update is None else []
    return [Text(_summary(evidence.coverage)), *doubts, picture]


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
        blocks.append(Text(f"The field at the centre is the mean of all sensors. {calibration_figure.NO_GRADIENT}"))
    return blocks


def _provenance(calibration: Calibration) -> list[Block]:
    """Return where the calibration comes from."""
    first, last = calibration.time_span_s
    rows = [
        *_source(calibration),
        ["samples", count(calibration.samples)],
        ["time", f"{fixed(first, 3)} s to {fixed(last, 3)} s, a span of {number(last - first, 4)} s"],
        ["mean intensity", f"{fixed(to_nanotesla(calibration.intensity_T), 1)} nT"],
        ["reference", "scalar magnetometer" if calibration.has_scalar_reference else "none"],
        ["method", calibration.method],
        ["software", f"tam_calibration {__version__}"],
    ]
    return [Table([], rows, numeric=False), _positions(calibration)]


def _source(calibration: Calibration) -> list[list[str]]:
    if calibration.source is None:
        return [["recording", "not from a file"]]
    source = calibration.source
    return [["recording", source.name], ["size", f"{count(source.size_bytes)} bytes"], ["SHA-256", source.sha256]]


def _positions(calibration: Calibration) -> Table:
    rows = [
        [str(i + 1), *(fixed(float(value), 4) for value in place)]
        for i, place in enumerate(calibration.array.positions_m)
    ]
    return Table(
        ["sensor", "x (m)", "y (m)", "z (m)"], rows, "Array: positions of the sensors, x forward, y left, z up."
    )


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
    evidence = calibration_figure.view_of(calibration, recording)
    sections = [
        Section("Verdict", _verdict(calibration)),
        Section("Residuals over time", _residuals(evidence)),
        Section("Coverage of the sphere", _coverage(evidence)),
        Section("Distribution of the residuals", _histograms(evidence)),
        Section("Parameters", _parameters(calibration)),
        Section("Prior and data", update_blocks(calibration.update) if calibration.update else []),
        Section("Known source", known_source_blocks(calibration)),
        Section("Quality", quality_blocks(calibration)),
        Section("Provenance", _provenance(calibration)),
    ]
    write_page(path, "Calibration report", _subtitle(calibration), sections)


def _subtitle(calibration: Calibration) -> str:
    sensors = "1 sensor" if calibration.errors.sensor_count == 1 else f"{calibration.errors.sensor_count} sensors"
    source = f"{calibration.source.name}, " if calibration.source else ""
    return f"{source}{sensors}, {count(calibration.samples)} samples"
