"""The report on a calibration: one HTML page for the people who will rely on it, section by section."""

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.linalg import inv

from tam_calibration import __version__
from tam_calibration.correction.calibration import Calibration, KnownSource
from tam_calibration.fit.coverage import Coverage
from tam_calibration.fit.identifiability import find_weakness
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import Residuals, ResidualSeries
from tam_calibration.model.units import to_degrees, to_nanotesla
from tam_calibration.report.calibration_rows import (
    NUMBERS_HEADER,
    effect_number_rows,
    effect_size_header,
    effect_size_rows,
    parameter_rows,
)
from tam_calibration.report.calibration_view import NO_GRADIENT, CalibrationView, view_of
from tam_calibration.report.formatting import count, fixed, join, number, ratio, sentence, with_error
from tam_calibration.report.page import (
    Block,
    Formula,
    Gallery,
    Image,
    Points,
    Section,
    Table,
    Text,
    embed,
    sections_of,
    write_page,
)
from tam_calibration.report.recording_plots import (
    COMPONENT_NAMES,
    Panel,
    intensity_panels,
    plot_coverage,
    plot_histograms,
    plot_over_time,
    tensor_panels,
    thinning_note,
)
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR
from tam_calibration.report.update_rows import share_rows, update_sentences
from tam_calibration.report.verdict import best_evidence, judge


def verdict_section(evidence: CalibrationView) -> Section:
    """Return whether the calibration can be relied on, and why it should be doubted."""
    verdict = judge(evidence.calibration, evidence.coverage)
    blocks: list[Block] = [Text(verdict.sentence, "doubt" if verdict.doubts else "good"), Text(_figures(evidence))]
    if verdict.doubts:
        blocks.append(Points([doubt.detail for doubt in verdict.doubts]))
    if verdict.limits:
        blocks += [Text("What limits this verdict:"), Points(verdict.limits)]
    return Section("Verdict", blocks)


def _figures(evidence: CalibrationView) -> str:
    calibration = evidence.calibration
    residuals = best_evidence(calibration)
    worst = int((residuals.sensor_intensity_T / calibration.floor.sensor_intensity_T).argmax())
    states = (calibration.before, residuals, calibration.floor)
    before, after, floor = (to_nanotesla(float(state.sensor_intensity_T[worst])) for state in states)
    sensor = f"sensor {worst + 1}, the worst," if calibration.errors.sensor_count > 1 else "the sensor"
    samples = "samples that the fit did not see" if calibration.held_out else "the samples that were fitted"
    return (
        f"|B| of {sensor} differs from {evidence.reference_name} by {number(before)} nT before and {number(after)} nT "
        f"after, {ratio(after / floor)} × the noise floor. The field visited {100 * evidence.coverage.fraction:.0f} % "
        f"of the sphere of directions. Figures after calibration are root mean squares over {samples}."
    )


def residuals_section(evidence: CalibrationView) -> Section:
    """Return the residuals over time, before and after."""
    blocks: list[Block] = [Text(_introduce(evidence))]
    blocks.append(_compare(evidence, intensity_panels, "nT", f"|B| − {evidence.reference_name}"))
    if evidence.calibration.array.has_gradient:
        blocks.append(_compare(evidence, tensor_panels, "nT/m", "Tensor components"))
    else:
        blocks.append(Text(NO_GRADIENT))
    return Section("Residuals over time", blocks)


def _introduce(evidence: CalibrationView) -> str:
    tensor = ", and the gradient tensor is zero" if evidence.calibration.array.has_gradient else ""
    return (
        f"In a uniform field the length |B| of every corrected vector equals {evidence.reference_name}{tensor}; "
        "what is left is the residual. The dashed lines are ± one standard deviation of the noise floor, which no "
        "calibration can remove. Before and after are drawn to their own scales. "
        f"{thinning_note(evidence.recording.sample_count)}"
    ).strip()


def _compare(
    evidence: CalibrationView, panels: Callable[[ResidualSeries, Residuals], list[Panel]], unit: str, what: str
) -> Gallery:
    pictures = []
    for state, color, series in (("before", BEFORE_COLOR, evidence.before), ("after", AFTER_COLOR, evidence.after)):
        figure = plot_over_time(evidence.recording.time_s, panels(series, evidence.calibration.floor), unit, color)
        title = f"{what}, {state} calibration"
        pictures.append(embed(figure, f"{title}, over time", title))
    return Gallery(pictures)


_INTRO = (
    "Residuals after calibration (blue) against the Gaussian of the noise floor (line), with their RMS over the floor. "
    "A histogram that is wider than its line, shifted or lopsided holds more than sensor noise. "
    "“Outside” counts samples beyond the axis."
)


def histograms_section(evidence: CalibrationView) -> Section:
    """Return how often the residuals have which size."""
    floor = evidence.calibration.floor
    pictures = [_histograms(intensity_panels(evidence.after, floor), "nT", f"|B| − {evidence.reference_name}")]
    if evidence.calibration.array.has_gradient:
        pictures.append(_histograms(tensor_panels(evidence.after, floor), "nT/m", "Tensor components"))
    return Section("Distribution of the residuals", [Text(_INTRO), Gallery(pictures)])


def _histograms(panels: Sequence[Panel], unit: str, what: str) -> Image:
    return embed(plot_histograms(panels, unit), f"Histograms: {what}, after calibration", f"{what}, after calibration")


def coverage_section(evidence: CalibrationView) -> Section:
    """Return which directions of the field were visited."""
    picture = embed(
        plot_coverage(evidence.coverage),
        "Map of the directions of the field",
        "Direction of the field in the array frame, equal-area (Hammer) map: forward is +x, left +y, up +z.",
    )
    weakness = find_weakness(evidence.recording, evidence.calibration)
    doubts = [Text(str(weakness))] if weakness.parameters and evidence.calibration.update is None else []
    return Section("Coverage of the sphere", [Text(_summary(evidence.coverage)), *doubts, picture])


def _summary(coverage: Coverage) -> str:
    seen = (
        f"The field visited {np.count_nonzero(coverage.counts)} of {len(coverage.counts)} cells of equal area "
        f"({100 * coverage.fraction:.0f} %)."
    )
    strength = "These directions do not determine every parameter."
    if np.isfinite(coverage.relative_error):
        size = number(coverage.relative_error)
        strength = f"The worst standard error is {size} × that of as many samples over the whole sphere."
    return f"{seen} {strength} {'' if coverage.enough else sentence(coverage.advice)}".strip()


_MODEL = (
    "Value ± standard error. The model is yᵢ = Dᵢ Λᵢ bᵢ + oᵢ: D holds scale factors and non-orthogonality, "
    "Λ the misalignment, o the bias."
)
_EFFECTS = (
    "Effects, fitted together with the errors of the sensors, whose standard errors hold what is not known of them."
)
_SIZES = "Root mean square, over the recording, of what the effects add to each output, and what is taken off it."
_SENSOR_BY_HAND = "By hand, the reading yᵢ of sensor i becomes the field bᵢ in the array frame by"
_ARRAY_BY_HAND = "Field and gradient at the centre are sums over the sensors, with the weights of the array's geometry:"
_WEIGHTS = "Weights W (no unit) of the centre field and G (1/m) of the gradient; empty where a reading does not count."


def parameters_section(evidence: CalibrationView) -> Section:
    """Return the parameters with their standard errors, and how to apply them by hand."""
    calibration = evidence.calibration
    blocks: list[Block] = [_parameters(calibration), *_effects(calibration)]
    blocks += [Text(statement) for statement in calibration.statements]
    blocks += [Text(_SENSOR_BY_HAND), Formula(["bᵢ = Cᵢ (yᵢ − oᵢ),   Cᵢ = (Dᵢ Λᵢ)⁻¹"]), _matrices(calibration)]
    if calibration.array.has_gradient:
        blocks += [Text(_ARRAY_BY_HAND), Formula(["b = Σᵢ Wᵢ bᵢ,   g = Σᵢ Gᵢ bᵢ"]), _weights(calibration)]
    else:
        blocks.append(Text(f"The field at the centre is the mean of all bᵢ. {NO_GRADIENT}"))
    return Section("Parameters", blocks)


def _parameters(calibration: Calibration) -> Table:
    sensors = [f"sensor {sensor + 1}" for sensor in range(calibration.errors.sensor_count)]
    return Table(["parameter", *sensors], parameter_rows(calibration), _MODEL)


def _effects(calibration: Calibration) -> list[Block]:
    blocks: list[Block] = []
    if calibration.effects:
        blocks.append(Table(list(NUMBERS_HEADER), effect_number_rows(calibration), _EFFECTS))
    if rows := effect_size_rows(calibration):
        blocks.append(Table(effect_size_header(), rows, _SIZES))
    return blocks


def _matrices(calibration: Calibration) -> Table:
    rows = []
    for sensor, matrix in enumerate(inv(calibration.errors.matrix)):
        for axis, name in enumerate("xyz"):
            bias = fixed(to_nanotesla(float(calibration.errors.bias_T[sensor, axis])), 3)
            rows.append([f"{sensor + 1} {name}", bias, *(fixed(float(value), 9) for value in matrix[axis])])
    header = ["sensor, axis", "o (nT)", "C, column x", "C, column y", "C, column z"]
    return Table(header, rows, "Bias o and matrix C of each sensor: the inverse of the calibration file's matrix.")


def _weights(calibration: Calibration) -> Table:
    names = [f"b{sensor + 1}{axis}" for sensor in range(calibration.errors.sensor_count) for axis in "xyz"]
    weights = zip(names, calibration.array.operator.T, strict=True)
    rows = [[name, *(_weight(float(value)) for value in row)] for name, row in weights]
    return Table(["from", *OUTPUT_NAMES], rows, _WEIGHTS)


def _weight(value: float) -> str:
    return "" if abs(value) < 1e-12 else fixed(value, 6).rstrip("0").rstrip(".")


_CHANNELS = {
    "differential": "between the sensors",
    "common_mode": "against the reference intensity",
    "slow_differential": "between the sensors in sums over many samples",
    "slow_common_mode": "against the reference intensity in sums over many samples",
}


def quality_section(evidence: CalibrationView) -> Section:
    """Return the residuals in and out of sample against the noise floor."""
    calibration = evidence.calibration
    return Section("Quality", [_residuals(calibration), Text(_chi_square(calibration)), Text(_noise(calibration))])


def _residuals(calibration: Calibration) -> Table:
    after = {"in sample": calibration.in_sample}
    caption = "Root mean square residuals. No samples were held out."
    if calibration.held_out is not None:
        after["out of sample"] = calibration.held_out
        caption = "Root mean square residuals. Out of sample: samples that the fit did not see."
    states = {"before": calibration.before, **after, "noise floor": calibration.floor}
    columns = {name: _noise_figures(state, calibration.array.has_gradient) for name, state in states.items()}
    rows = []
    for quantity, floor in columns["noise floor"].items():
        ratios = [ratio(columns[name][quantity] / floor) for name in after]
        rows.append([quantity, *(number(column[quantity]) for column in columns.values()), *ratios])
    return Table(["residual", *columns, *(f"{name} / floor" for name in after)], rows, caption)


def _noise_figures(residuals: Residuals, has_gradient: bool) -> dict[str, float]:
    """Return all residuals in nT and nT/m by name."""
    sensors = residuals.sensor_intensity_T
    figures = {f"|B|, sensor {sensor + 1} (nT)": float(value) for sensor, value in enumerate(sensors)}
    if len(sensors) > 1:
        figures["|B|, centre (nT)"] = residuals.center_intensity_T
    if has_gradient:
        components = zip(COMPONENT_NAMES, residuals.tensor_T_per_m, strict=True)
        figures |= {f"tensor {name} (nT/m)": float(value) for name, value in components}
        figures["tensor, all five (nT/m)"] = residuals.tensor_rmse_T_per_m
    return {name: to_nanotesla(value) for name, value in figures.items()}


def _chi_square(calibration: Calibration) -> str:
    if not calibration.reduced_chi_square:
        return "There is no redundancy, hence no reduced χ²."
    values = [f"{number(value)} {_CHANNELS.get(name, name)}" for name, value in calibration.reduced_chi_square.items()]
    return f"Reduced χ²: {join(values)}; it is 1 where noise alone is left."


def _noise(calibration: Calibration) -> str:
    array = calibration.array
    noises = [number(to_nanotesla(float(value))) for value in array.vector_noise_T]
    vector = f"{noises[0]} nT for every sensor" if len(set(noises)) == 1 else f"{join(noises)} nT, sensor by sensor"
    scalar = ""
    if calibration.has_scalar_reference:
        scalar = f"; of the scalar magnetometer: {number(to_nanotesla(array.scalar_noise_T))} nT"
    origin = "estimated from this recording where it was not" if calibration.noise_is_estimated else "as"
    return f"Noise per axis: {vector}{scalar}; {origin} stated for the array."


_SHARES = (
    "Part of the information on each parameter that this recording gave; the rest is that of the prior. One less the "
    "ratio of the variances after and before."
)


def prior_section(evidence: CalibrationView) -> Section | None:
    """Return what came from an older calibration, and what moved since; None where there was no prior."""
    update = evidence.calibration.update
    if update is None:
        return None
    first, *others = update_sentences(update)
    sensors = [f"sensor {sensor + 1}" for sensor in range(len(update.data_share))]
    told = [Text(words, "doubt" if update.moved else "good") for words in others]
    return Section("Prior and data", [Text(first), *told, Table(["parameter", *sensors], share_rows(update), _SHARES)])


_INTRODUCTION = (
    "A uniform field sees neither the length of the baselines, nor a turn of all sensors together, nor where the "
    "elements of the axes sit. The field of a known source did; array and matrices on this page hold what it showed."
)
_COMMON = "Value ± standard error, of the noise of the source's amplitudes; the source itself counts as exact."
_PLACES = "Place of the element of each axis beside its sensor (mm), array frame ± standard error."
_DOUBTFUL = 2.0
"""Reduced χ² above which source and array do not fit each other."""


def known_source_section(evidence: CalibrationView) -> Section | None:
    """Return what a known source showed of the array; None where none was recorded."""
    calibration = evidence.calibration
    found = calibration.known_source
    if found is None:
        return None
    return Section("Known source", [Text(_INTRODUCTION), _common(found), *_verdict(found), _places(calibration, found)])


def _common(found: KnownSource) -> Table:
    turns = zip("xyz", to_degrees(found.rotation), to_degrees(found.rotation_standard_errors), strict=True)
    rows = [
        ["true baselines over stated", with_error(found.baseline_scale, found.baseline_scale_standard_error, 4)],
        *([f"turn of the frame about {axis} (°)", with_error(float(v), float(e), 4)] for axis, v, e in turns),
        ["reduced χ²", number(found.reduced_chi_square)],
    ]
    return Table(["quantity", "value"], rows, _COMMON)


def _verdict(found: KnownSource) -> list[Text]:
    if found.reduced_chi_square <= _DOUBTFUL:
        return []
    return [
        Text(
            f"Reduced χ² is {number(found.reduced_chi_square)} where 1 is expected: the source is not quite where or "
            "what it was stated to be, or the array has an error of another kind; the standard errors are too small.",
            "doubt",
        )
    ]


def _places(calibration: Calibration, found: KnownSource) -> Table:
    offsets = calibration.array.axis_offsets_m
    assert offsets is not None
    errors = found.axis_offsets_standard_errors_m
    rows = [
        [f"{sensor + 1} {'xyz'[axis]}", *_millimetres(offsets[sensor, axis], errors[sensor, axis])]
        for sensor, axis in np.ndindex(*offsets.shape[:2])
    ]
    return Table(["sensor, axis", "x", "y", "z"], rows, _PLACES)


def _millimetres(values: np.ndarray, errors: np.ndarray) -> list[str]:
    pairs = zip(1e3 * values, 1e3 * errors, strict=True)
    return [with_error(float(value), float(error), 2) for value, error in pairs]


def provenance_section(evidence: CalibrationView) -> Section:
    """Return where the calibration comes from."""
    calibration = evidence.calibration
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
    return Section("Provenance", [Table([], rows, numeric=False), _positions(calibration)])


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


SECTIONS: tuple[Callable[[CalibrationView], Section | None], ...] = (
    verdict_section,
    residuals_section,
    coverage_section,
    histograms_section,
    parameters_section,
    prior_section,
    known_source_section,
    quality_section,
    provenance_section,
)
"""In the order in which they are read."""


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
    evidence = view_of(calibration, recording)
    write_page(path, "Calibration report", _subtitle(calibration), sections_of(SECTIONS, evidence))


def _subtitle(calibration: Calibration) -> str:
    sensors = "1 sensor" if calibration.errors.sensor_count == 1 else f"{calibration.errors.sensor_count} sensors"
    source = f"{calibration.source.name}, " if calibration.source else ""
    return f"{source}{sensors}, {count(calibration.samples)} samples"
