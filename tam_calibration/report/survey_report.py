"""A survey, as rows for the terminal and as pages: where a source is, and what survey lines show.

That of a source has maps in plan and profile with error ellipses, and the spectrum of an alternation; that of lines a
map with the targets, and what each line shows along its way.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tam_calibration.localization.solutions import ARRAY_FRAME, ELLIPSOID_PROBABILITY, Overall, Survey, standard_errors
from tam_calibration.localization.targets import SurveyLine, Target
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla
from tam_calibration.report import blocks, page
from tam_calibration.report.page import embed, write_page
from tam_calibration.sources.demodulation import Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.patches import Ellipse

MOST_ROWS = 20
"""Samples that are shown; of more, some from the first to the last."""


def survey_answer(survey: Survey) -> str:
    """Return where the source is and how strong, in one line."""
    located, total = int(survey.solutions.is_located.sum()), len(survey.time_s)
    some = f"located in {blocks.count(located)} of {blocks.count(total)} samples by themselves"
    if survey.overall is None:
        distance = survey.solutions.distance_m[survey.solutions.is_located]
        near, far = (blocks.number(float(each)) for each in (distance.min(), distance.max()))
        return f"A source is {some}, at {near} to {far} m."
    ((_, x, y, z, _), (*_, size)) = _overall_rows(survey.overall)
    return f"A source is at x {x}, y {y}, z {z} m, moment {size} A m²."


def source_blocks(survey: Survey) -> list[blocks.Block]:
    """Return where the source of all samples is; empty where there is none."""
    if survey.overall is None:
        return []
    caption = "The source of all samples together ± standard errors."
    return [blocks.Table(("", "x", "y", "z", "size"), _overall_rows(survey.overall), caption)]


def sample_blocks(survey: Survey, most: int = MOST_ROWS) -> list[blocks.Block]:
    """Return where single samples see the source, of many some from first to last; empty where none does."""
    located = np.flatnonzero(survey.solutions.is_located)
    shown = located[np.unique(np.linspace(0, len(located) - 1, min(len(located), most)).round().astype(int))]
    distance = survey.solutions.distance_m
    moments, spreads = survey.solutions.moment_Am2, survey.solutions.moment_covariance_A2m4
    rows = [
        [
            blocks.number(float(survey.time_s[index] - survey.time_s[0]), 4),
            *blocks.with_errors(survey.solutions.position_m[index], survey.position_standard_errors_m[index], 3),
            blocks.number(float(distance[index])),
            _size(moments[index], spreads[index]),
        ]
        for index in shown
    ]
    header = ("time (s)", "x (m)", "y (m)", "z (m)", "distance (m)", "moment (A m²)")
    caption = "Position ± standard error of samples by themselves; of many some from first to last."
    return [blocks.Table(header, rows, caption)] if rows else []


def _overall_rows(overall: Overall) -> list[list[str]]:
    """Return rows of position, moment and fit of the source of all samples."""
    position = blocks.with_errors(overall.position_m, standard_errors(overall.position_covariance_m2), 3)
    moment = blocks.with_errors(overall.moment_Am2, standard_errors(overall.moment_covariance_A2m4), 3)
    size = _size(overall.moment_Am2, overall.moment_covariance_A2m4)
    return [
        ["position (m)", *position, blocks.number(float(np.linalg.norm(overall.position_m)))],
        ["moment (A m²)", *moment, size],
    ]


def statements(survey: Survey) -> list[str]:
    """Return statements on all of it, one sentence each."""
    words = [f"{survey.frame[:1].upper()}{survey.frame[1:]}."]
    if survey.line is not None:
        error = survey.line.standard_error_hz
        stated = "as stated" if np.isnan(error) else "found"
        hertz = survey.line.frequency_hz
        told = blocks.number(hertz, 6) if np.isnan(error) else blocks.with_error(hertz, error, 4)
        words.append(f"Frequency: {told} Hz, {stated}; amplitudes are peak values.")
    if survey.regional_T is not None:
        field = ", ".join(blocks.number(float(value), 6) for value in to_nanotesla(survey.regional_T))
        words.append(f"Regional field taken off, in the world: {field} nT.")
    if survey.overall is not None and np.isfinite(survey.overall.chi_square):
        reduced = survey.overall.chi_square / survey.overall.degrees_of_freedom
        words.append(
            f"Reduced χ² of all together: {blocks.number(reduced)}; near 1 where one dipole explains the readings."
        )
    words += [survey.note] * bool(survey.note)
    located, total = int(survey.solutions.is_located.sum()), len(survey.time_s)
    words.append(f"{blocks.count(located)} of {blocks.count(total)} located.")
    words += [f"{blocks.count(times)} refused: {status.reason}." for status, times in survey.refusals.most_common()]
    return words


def _size(vector: FloatArray, covariance: FloatArray) -> str:
    size = float(np.linalg.norm(vector))
    return blocks.with_error(size, float(np.sqrt(vector @ covariance @ vector)) / size, 3)


def targets_answer(targets: Sequence[Target]) -> str:
    """Return what a line shows, in one line."""
    if not targets:
        return "No target is seen along the line."
    extended = sum(each.is_extended for each in targets)
    of_them = f", {blocks.count(extended)} of them extended or too near for a dipole" if extended else ""
    return f"{blocks.counted(len(targets), 'target')} along the line{of_them}."


def target_table(targets: Sequence[Target]) -> blocks.Table:
    """Return a table with a row for each target: place and moment ± standard errors, distance, and what it is."""
    header = ("x (m)", "y (m)", "z (m)", "moment (A m²)", "distance (m)", "lines", "")
    rows = []
    for each in targets:
        places = blocks.with_errors(each.position_m, standard_errors(each.position_covariance_m2), 3)
        size = _size(each.moment_Am2, each.moment_covariance_A2m4)
        what = "dipole"
        if each.is_extended:
            what = f"extended over {blocks.number(each.extent_m, 2)} m" if each.extent_m else "extended or too near"
        rows.append([*places, size, blocks.number(each.distance_m), blocks.count(each.lines), what])
    return blocks.Table(header, rows, "Places in the world of the attitude ± standard errors.")


_VIEWS = (((0, 1), "plan"), ((0, 2), "profile"), ((1, 2), "profile"))
_NAMES = {True: ("x, forward", "y, left", "z, up"), False: ("x", "y", "z")}


@dataclass(frozen=True, eq=False)
class _Window:
    """What is shown: a square about a point, in a unit of which a metre has ``scale``, from an origin."""

    middle_m: FloatArray
    half_m: float
    origin_m: FloatArray | float = 0.0
    scale: float = 1.0
    unit: str = "m"

    def shown(self, points_m: FloatArray) -> FloatArray:
        """Return points (…, 3) as they are drawn."""
        return self.scale * (points_m - self.origin_m)


@page.in_style
def plot_survey_map(survey: Survey) -> "Figure":
    """Draw sources and array from above and from two sides, with ellipses that hold 95 %; magnified below."""
    windows = _windows(survey)
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 0.6 + 2.5 * len(windows))
    names = _NAMES[survey.frame == ARRAY_FRAME]
    panels = figure.subplots(len(windows), len(_VIEWS), squeeze=False)
    for row, window in zip(panels, windows, strict=True):
        for axes, (view, title) in zip(row, _VIEWS, strict=True):
            across, up = (names[axis] for axis in view)
            _draw_view(axes, survey, list(view), window)
            axes.set_title(f"{title}, {across[0]} and {up[0]}", loc="left")
            axes.set(xlabel=f"{across} ({window.unit})", ylabel=f"{up} ({window.unit})", aspect="equal")
    handles = panels[0, 0].get_legend_handles_labels()
    figure.legend(*handles, loc="outside lower center", ncols=len(handles[0]), frameon=False, fontsize=8)
    return figure


@page.in_style
def plot_source_spectrum(spectrum: Spectrum, frequency_hz: float) -> "Figure":
    """Draw the power of all readings over that of their noise; the frequency that was demodulated is marked.

    Parameters
    ----------
    spectrum : Spectrum
        Frequencies, hertz, power over that of noise, and the threshold that chance reaches.
    frequency_hz : float
        Frequency of the source, hertz.
    """
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 2.6)
    axes = figure.subplots()
    axes.plot(spectrum.frequency_hz, spectrum.power, color=page.AFTER_COLOR, linewidth=0.7, rasterized=True)
    axes.axhline(spectrum.threshold, color=page.FLOOR_COLOR, linestyle="--", linewidth=0.8, label="what chance reaches")
    axes.axvline(frequency_hz, color=page.BEFORE_COLOR, alpha=0.4, linewidth=4, zorder=0, label="the source")
    axes.set(yscale="log", xlabel="frequency (Hz)", ylabel="power over that of noise")
    axes.set_ylim(bottom=0.1)
    axes.legend(frameon=False, fontsize=8)
    return figure


def _draw_view(axes: "Axes", survey: Survey, pair: list[int], window: _Window) -> None:
    solutions = survey.solutions
    axes.plot(*window.shown(np.zeros(3))[pair], "+", color=page.FLOOR_COLOR, label="the array")
    located = np.flatnonzero(solutions.is_located)
    points = window.shown(solutions.position_m)
    axes.plot(*points[located][:, pair].T, ".", color=page.QUIET_COLOR, markersize=3, label="source of one sample")
    # More than 40 ellipses cover one another.
    for index in located[:: max(1, len(located) // 40)]:
        spread = solutions.position_covariance_m2[index][np.ix_(pair, pair)]
        axes.add_patch(error_ellipse(points[index, pair], spread, page.QUIET_COLOR, 0.4, window.scale))
    if (overall := survey.overall) is not None:
        place = window.shown(overall.position_m)[pair]
        axes.plot(*place, "x", color=page.BEFORE_COLOR, label="source of all together")
        spread = overall.position_covariance_m2[np.ix_(pair, pair)]
        axes.add_patch(error_ellipse(place, spread, page.BEFORE_COLOR, 1.4, window.scale))
    middle, half = window.shown(window.middle_m)[pair], window.scale * window.half_m
    axes.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))


def _windows(survey: Survey) -> list[_Window]:
    """Return the array with the source, and the ellipses magnified where there is one source of all samples.

    Without one the view leaves out the worst fifth of the sources.
    """
    overall, located = survey.overall, survey.solutions.position_m[survey.solutions.is_located]
    if overall is None:
        points = np.concatenate([np.zeros((1, 3)), np.percentile(located, (10, 90), axis=0)])
        low, high = points.min(axis=0), points.max(axis=0)
        return [_Window((low + high) / 2, 0.6 * float((high - low).max()))]
    distance = float(np.linalg.norm(overall.position_m))
    axis = _half_axis() * float(np.sqrt(np.linalg.eigvalsh(overall.position_covariance_m2)[-1]))
    return [
        _Window(overall.position_m / 2, 0.8 * distance),
        _Window(overall.position_m, 8.0 * axis, overall.position_m, 1e3, "mm from the source"),
    ]


def _half_axis() -> float:
    """Return the half axis, in standard deviations, of an ellipse with that probability: χ² of two dimensions."""
    return float(np.sqrt(-2 * np.log1p(-ELLIPSOID_PROBABILITY)))


def error_ellipse(
    center: FloatArray, covariance: FloatArray, color: str, width: float, scale: float = 1.0
) -> "Ellipse":
    """Return the ellipse about a point (2,) that holds 95 % of a covariance (2, 2), its axes times a scale."""
    from matplotlib.patches import Ellipse

    values, vectors = np.linalg.eigh(covariance)
    axis = vectors[:, 1]
    angle = to_degrees(float(np.arctan2(axis[1], axis[0])))
    size = scale * 2 * _half_axis() * np.sqrt(np.maximum(values, 0))
    return Ellipse((center[0], center[1]), size[1], size[0], angle=angle, fill=False, edgecolor=color, linewidth=width)


_MAP = "The source in plan and in profile, with ellipses that hold 95 %; the array for scale. "
_MAGNIFIED = "Below, magnified, the source of all samples together among those of single samples."
_SPECTRUM = "Power of all readings over that of their noise, background taken off; dashed what chance reaches."


def _where(survey: Survey) -> list[blocks.Block]:
    """Return the map of the source, and where it is in numbers and words."""
    caption = _MAP if survey.overall is None else _MAP + _MAGNIFIED
    picture = embed(plot_survey_map(survey), "Map of the source in plan and profile", caption)
    return [*source_blocks(survey), picture, blocks.Points(statements(survey))]


def _spectrum(survey: Survey) -> list[blocks.Block]:
    """Return the spectrum in which the frequency of an alternating source was found."""
    if survey.line is None or survey.line.spectrum is None:
        return []
    figure = plot_source_spectrum(survey.line.spectrum, survey.line.frequency_hz)
    words = f"Spectrum of the readings with a line at {blocks.fixed(survey.line.frequency_hz, 4)} Hz"
    return [embed(figure, words, _SPECTRUM)]


def write_survey_report(path: Path, survey: Survey, recording_name: str) -> None:
    """Write a self-contained HTML page on where the source of a recording is.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails.
    survey : Survey
        What was found.
    recording_name : str
        Of the recording's file.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    subtitle = f"{recording_name}, {blocks.count(len(survey.time_s))} {'poses' if survey.line else 'samples'}"
    sections = [
        blocks.Section("Where the source is", _where(survey)),
        blocks.Section("Spectrum", _spectrum(survey)),
        blocks.Section("Samples", sample_blocks(survey)),
    ]
    write_page(path, "Source report", subtitle, sections)


_LINES = "Lines and targets in plan, with ellipses that hold 95 %; an extended target is drawn as a square."
_COURSE = (
    "Along the line: intensity less its median, the square root of the gradient tensor's contraction, and "
    "the root mean square of the residuals over the noise, which is near 1 where the targets explain the readings. "
    "Dotted: targets."
)


@page.in_style
def _plot_lines(lines: Sequence[SurveyLine], targets: Sequence[Target]) -> "Figure":
    """Draw lines and targets in plan, east and north."""
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 3.6)
    axes = figure.subplots()
    for line in lines:
        axes.plot(*line.center_m[:, :2].T, color=page.FLOOR_COLOR, linewidth=1.0)
    for place_in_list, target in enumerate(targets, 1):
        place = float(target.position_m[0]), float(target.position_m[1])
        axes.plot(*place, "s" if target.is_extended else "x", color=page.BEFORE_COLOR, fillstyle="none")
        axes.annotate(str(place_in_list), place, xytext=(4, 4), textcoords="offset points", fontsize=8)
        spread = target.position_covariance_m2[:2, :2]
        axes.add_patch(error_ellipse(target.position_m[:2], spread, page.BEFORE_COLOR, 1.2))
    axes.set(xlabel="x, east (m)", ylabel="y, north (m)", aspect="equal")
    axes.set_adjustable("datalim")
    return figure


@page.in_style
def _plot_course(line: SurveyLine) -> "Figure":
    """Draw the anomaly, the invariant of the gradient and what is left along a line."""
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 4.6)
    panels: Sequence[Axes] = figure.subplots(3, 1, sharex=True)
    courses = (
        (to_nanotesla(line.intensity_T - np.median(line.intensity_T)), "intensity (nT)", "linear"),
        (to_nanotesla(line.contraction_T_per_m), "gradient (nT/m)", "log"),
        (line.left, "residual / noise", "linear"),
    )
    passed = [line.along_m[np.argmin(np.linalg.norm(line.center_m - each.position_m, axis=1))] for each in line.targets]
    for axes, (values, label, scale) in zip(panels, courses, strict=True):
        axes.plot(line.along_m, values, color=page.AFTER_COLOR, linewidth=0.8)
        axes.set(ylabel=label, yscale=scale)
        for way in passed:
            axes.axvline(way, color=page.BEFORE_COLOR, linestyle=":", linewidth=0.8)
    panels[-1].set_xlabel("way along the line (m)")
    return figure


def write_targets_report(
    path: Path, lines: Sequence[SurveyLine], targets: Sequence[Target], names: Sequence[str]
) -> None:
    """Write a self-contained HTML page on survey lines.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails.
    lines : sequence of SurveyLine
        The lines.
    targets : sequence of Target
        Of all lines together.
    names : sequence of str
        Of the recordings, in the order of the lines.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    parts = [target_table(targets)] if targets else []
    picture = embed(_plot_lines(lines, targets), "Map of the lines and their targets", _LINES)
    sections = [blocks.Section("Targets", [*parts, picture])]
    for line, name in zip(lines, names, strict=True):
        notes = [blocks.Text(f"{line.note[0].upper()}{line.note[1:]}.")] if line.note else []
        course = embed(_plot_course(line), f"Course along the line {name}", _COURSE)
        sections.append(blocks.Section(name, [*notes, course]))
    write_page(path, "Survey lines", targets_answer(targets), sections)
