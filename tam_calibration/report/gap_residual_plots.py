"""The residuals of a gap drawn: by sensor and axis, over time, by size and by frequency; and the course of its law."""

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from tam_calibration.gap.laws.law import Course
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report.formatting import ratio
from tam_calibration.report.gap_cause_plots import GapView, State
from tam_calibration.report.page import BEFORE_COLOR, FLOOR_COLOR, MISSING_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.report.recording_plots import Panel, draw_over_time, plot_distributions

_SHADES = LinearSegmentedColormap.from_list("gap", ["#f4f6f8", BEFORE_COLOR, "#5a2f06"])


@matplotlib.rc_context(STYLE)
def plot_map(view: GapView) -> Figure:
    """Draw root mean squares over the floor, sensors downwards and axes across, one map a state on one scale."""
    states = view.states
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 1.3 + 0.3 * (view.sensor_count + 1)), layout="constrained")
    largest = np.nanmax([*(np.nanmax(state.ratio, initial=1.0) for state in states), 2.0])
    scale = LogNorm(1.0, largest, clip=True)
    for index, (axes, state) in enumerate(zip(figure.subplots(1, len(states), squeeze=False)[0], states, strict=True)):
        _draw(axes, state, view.sensor_count, scale)
        if index:
            axes.set_yticklabels([])
    figure.supxlabel("root mean square of the residual, in noise floors")
    return figure


def _draw(axes: Axes, state: State, sensor_count: int, scale: LogNorm) -> None:
    cells: FloatArray = np.full((sensor_count + 1, 3), np.nan)
    cells[:-1] = state.ratio[:-1].reshape(-1, 3)
    cells[-1, 1] = state.ratio[-1]
    axes.imshow(cells, cmap=_SHADES, norm=scale, aspect="auto")
    for row, column in np.argwhere(np.isfinite(cells)):
        value = float(cells[row, column])
        color = "white" if value**2 > float(scale.vmax or 1.0) else FLOOR_COLOR
        axes.text(column, row, ratio(value), ha="center", va="center", color=color, fontsize=8)
    axes.set_xticks(range(3), ["x", "y", "z"])
    axes.set_yticks(range(sensor_count + 1), [*(f"sensor {k + 1}" for k in range(sensor_count)), "scalar"])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(state.name, loc="left", color=state.color)


@matplotlib.rc_context(STYLE)
def plot_time(view: GapView, row: int) -> Figure:
    """Draw the residual of one row over time, one panel a state on common axes; the span of the gap is shaded.

    Parameters
    ----------
    view : GapView
        The gap with its residuals.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    residue, where = view.gap.residue, view.gap.where
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 4.2), layout="constrained")
    floor = to_nanotesla(float(residue.floor_T[row]))
    panels = [Panel(state.name, to_nanotesla(state.rows_T[:, row]), floor, state.color) for state in view.states]
    seconds = draw_over_time(figure, residue.time_s, panels, "nT")
    if where.time_s is not None:
        span = (np.array(where.time_s) - residue.time_s[0]) / seconds
        for axes in figure.axes:
            axes.axvspan(*span, color=MISSING_COLOR, alpha=0.2, linewidth=0)
    return figure


def plot_histogram(view: GapView, row: int) -> Figure:
    """Draw the distributions of one row, all states together, on a logarithmic scale that shows the tails.

    Parameters
    ----------
    view : GapView
        The gap with its residuals.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    floor = float(view.gap.residue.floor_T[row])
    drawn = [Panel(state.name, state.rows_T[:, row], floor, state.color) for state in view.states]
    return plot_distributions(drawn, f"residual of {view.row_name(row)}, in noise floors")


@matplotlib.rc_context(STYLE)
def plot_spectrum(view: GapView, row: int) -> Figure:
    """Draw the amplitude spectrum of one row, all states together; the band of the gap is shaded.

    Parameters
    ----------
    view : GapView
        The gap with its residuals.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    residue, where = view.gap.residue, view.gap.where
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 3.0), layout="constrained")
    axes = figure.subplots()
    floor = float(residue.floor_T[row])
    for state in view.states:
        frequency, amplitude = spectrum(residue.time_s, state.rows_T[:, row] / floor)
        axes.plot(frequency, amplitude, color=state.color, linewidth=1.2, label=state.name)
    axes.axhline(1, color=FLOOR_COLOR, linestyle="dashed", linewidth=0.8)
    axes.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"{view.row_name(row)}, in noise floors")
    if where.frequency_hz is not None:
        low, high = axes.get_xlim()
        axes.axvspan(max(where.frequency_hz[0], low), min(where.frequency_hz[1], high), color=MISSING_COLOR, alpha=0.2)
        axes.set_xlim(low, high)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.legend(frameon=False, fontsize=8)
    return figure


def spectrum(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (Hz) and amplitudes of a series with holes, averaged over bands; white unit noise gives 1.

    The samples are placed on a grid of their median step, with zeros in its gaps; where the grid would be too long, the
    samples are taken as consecutive.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, seconds, rising.
    values : (N,) array
        The series, in noise floors; NaN where there is none.
    """
    step = float(np.median(np.diff(time_s)))
    place = np.rint((time_s - time_s[0]) / step).astype(int)
    # A longer grid than six hours at 100 Hz has long holes.
    if place[-1] >= (1 << 21):
        place = np.arange(len(time_s))
    known = np.isfinite(values)
    grid = np.zeros(place[-1] + 1)
    grid[place[known]] = values[known]
    power = np.abs(np.fft.rfft(grid)[1:]) ** 2 / max(int(known.sum()), 1)
    frequency = np.fft.rfftfreq(len(grid), step)[1:]
    # About one band for three points of the page.
    band = np.digitize(frequency, np.geomspace(frequency[0], frequency[-1], 250)[1:-1])
    counts = np.bincount(band)
    filled = counts > 0
    centers = np.bincount(band, frequency)[filled] / counts[filled]
    return centers, np.sqrt(np.bincount(band, power)[filled] / counts[filled])


@matplotlib.rc_context(STYLE)
def plot_course(course: Course) -> Figure:
    """Draw the size of a law over time, and the band of two standard errors on either side."""
    factor, unit = (100.0, "%") if course.unit == "1" else (to_nanotesla(1.0), "nT")
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.2), layout="constrained")
    axes = figure.subplots()
    seconds, size, error = course.time_s - course.time_s[0], factor * course.size, factor * course.error
    axes.fill_between(seconds, size - 2 * error, size + 2 * error, color=BEFORE_COLOR, alpha=0.25, linewidth=0)
    axes.plot(seconds, size, color=BEFORE_COLOR)
    axes.set_xlabel("time, s")
    axes.set_ylabel(unit)
    return figure
