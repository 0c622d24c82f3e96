"""Maps of a survey in plan and profile with error ellipses, and the spectrum of an alternating source."""

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from tam_calibration.localization.spectrum import Spectrum
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, QUIET_COLOR, STYLE
from tam_calibration.survey.result import ARRAY_FRAME, Survey
from tam_calibration.units import FloatArray, to_degrees

_SIZE_INCH = (7.4, 3.6)
_VIEWS = (((0, 1), "plan"), ((0, 2), "profile"), ((1, 2), "profile"))
_NAMES = {True: ("x, forward", "y, left", "z, up"), False: ("x", "y", "z")}
_NINETY_FIVE = np.sqrt(5.991)
"""Half axis, in standard deviations, of an ellipse that holds 95 %: χ² with two degrees of freedom."""
_MOST_ELLIPSES = 40


@matplotlib.rc_context(STYLE)
def plot_survey_map(survey: Survey) -> Figure:
    """Draw sources and array from above and from two sides, with ellipses that hold 95 %."""
    figure = Figure(figsize=_SIZE_INCH, layout="constrained")
    names = _NAMES[survey.frame == ARRAY_FRAME]
    panels = figure.subplots(1, len(_VIEWS))
    for axes, (view, title) in zip(panels, _VIEWS, strict=True):
        _draw_view(axes, survey, view)
        axes.set_title(f"{title}, {names[view[0]][0]} and {names[view[1]][0]}", loc="left")
        axes.set(xlabel=f"{names[view[0]]} (m)", ylabel=f"{names[view[1]]} (m)", aspect="equal")
    figure.legend(
        *panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False, fontsize=8
    )
    return figure


@matplotlib.rc_context(STYLE)
def plot_source_spectrum(spectrum: Spectrum, frequency_hz: float) -> Figure:
    """Draw the power of all readings over that of their noise; the frequency that was demodulated is marked."""
    figure = Figure(figsize=(_SIZE_INCH[0], 2.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(spectrum.frequency_hz, spectrum.power, color=AFTER_COLOR, linewidth=0.7, rasterized=True)
    axes.axhline(spectrum.threshold, color=FLOOR_COLOR, linestyle="--", linewidth=0.8, label="what chance reaches")
    axes.axvline(frequency_hz, color=BEFORE_COLOR, alpha=0.4, linewidth=4, zorder=0, label="the source")
    axes.set(yscale="log", xlabel="frequency (Hz)", ylabel="power over that of noise")
    axes.set_ylim(bottom=0.1)
    axes.legend(frameon=False, fontsize=8)
    return figure


def _draw_view(axes: Axes, survey: Survey, view: tuple[int, int]) -> None:
    solutions, pair = survey.solutions, list(view)
    axes.plot(*survey.center_m[:, pair].T, color=FLOOR_COLOR, linewidth=1.0, marker="" if _moves(survey) else "+")
    axes.plot([], [], color=FLOOR_COLOR, marker="+", label="the array")
    located = np.flatnonzero(solutions.is_located)
    axes.plot(
        *solutions.position_m[located][:, pair].T, ".", color=QUIET_COLOR, markersize=3, label="source of one sample"
    )
    for index in located[:: -(-len(located) // _MOST_ELLIPSES) or 1]:
        spread = solutions.position_covariance_m2[index][np.ix_(pair, pair)]
        axes.add_patch(_ellipse(solutions.position_m[index, pair], spread, QUIET_COLOR, 0.5))
    if (overall := survey.overall) is not None:
        axes.plot(*overall.position_m[pair], "x", color=BEFORE_COLOR, label="source of all together")
        spread = overall.position_covariance_m2[np.ix_(pair, pair)]
        axes.add_patch(_ellipse(overall.position_m[pair], spread, BEFORE_COLOR, 1.4))
    middle, half = _extent(survey)
    axes.set_xlim(middle[pair[0]] - half, middle[pair[0]] + half)
    axes.set_ylim(middle[pair[1]] - half, middle[pair[1]] + half)


def _moves(survey: Survey) -> bool:
    return bool(np.ptp(survey.center_m, axis=0).any())


def _extent(survey: Survey) -> tuple[FloatArray, float]:
    """Return middle (3,) and half width of what all views show: array and sources, save the worst fifth of those."""
    located = survey.solutions.position_m[survey.solutions.is_located]
    sources = np.percentile(located, (10, 90), axis=0) if survey.overall is None else survey.overall.position_m[None]
    points = np.concatenate([survey.center_m, sources])
    low, high = points.min(axis=0), points.max(axis=0)
    return (low + high) / 2, 0.6 * float((high - low).max())


def _ellipse(center: FloatArray, covariance: FloatArray, color: str, width: float) -> Ellipse:
    values, vectors = np.linalg.eigh(covariance)
    axis = vectors[:, 1]
    angle = to_degrees(float(np.arctan2(axis[1], axis[0])))
    size = 2 * _NINETY_FIVE * np.sqrt(np.maximum(values, 0))
    return Ellipse((center[0], center[1]), size[1], size[0], angle=angle, fill=False, edgecolor=color, linewidth=width)
