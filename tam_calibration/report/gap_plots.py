"""A gap drawn: the probabilities and shares of its causes, and residuals over all that they may depend on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from tam_calibration.fit.coverage import CELLS, cell_of
from tam_calibration.gap.laws.law import Course
from tam_calibration.gap.result import Gap, Residue
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla
from tam_calibration.report import page
from tam_calibration.report.blocks import ratio
from tam_calibration.report.gap_rows import percent
from tam_calibration.report.recording_plots import Panel, cells_on_map, draw_borders, draw_over_time, plot_distributions


@dataclass(frozen=True, eq=False)
class State:
    """Residuals (N, 3K + 1) of one kind, tesla: its name, its colour, and the residue that they are of."""

    name: str
    color: str
    rows_T: FloatArray
    residue: Residue

    @cached_property
    def ratio(self) -> FloatArray:
        """The root mean squares of the rows over the floor, NaN for a row without information."""
        known_T = np.ma.masked_invalid(np.where(self.rows_T == 0, np.nan, self.rows_T))
        floor_T = np.ma.masked_less_equal(np.ma.masked_invalid(self.residue.floor_T), 0.0)
        return np.asarray((np.sqrt(np.mean(known_T**2, axis=0)) / floor_T).filled(np.nan))

    def row_name(self, row: int) -> str:
        """Return "sensor 2 x" or "scalar"."""
        return "scalar" if row == self.rows_T.shape[1] - 1 else f"sensor {row // 3 + 1} {'xyz'[row % 3]}"


@dataclass(frozen=True, eq=False)
class GapView:
    """A gap as its figures show it."""

    gap: Gap

    @cached_property
    def states(self) -> tuple[State, ...]:
        """The recording, the recording without its causes where there are any, and the twin."""
        residue = self.gap.residue
        kinds = [("recording", page.BEFORE_COLOR, residue.before)]
        if self.gap.causes:
            kinds.append(("without its causes", page.AFTER_COLOR, residue.after))
        kinds.append(("simulated twin", page.QUIET_COLOR, residue.twin))
        return tuple(State(name, color, rows, residue) for name, color, rows in kinds)

    @cached_property
    def rows(self) -> tuple[int, ...]:
        """The rows to draw: those with the largest residual in the place of the gap, and in that of each cause."""
        gap = self.gap
        places = [(gap.where.sensors, gap.where.axes), *((cause.sensors, cause.axes) for cause in gap.causes)]
        return tuple(dict.fromkeys(self._largest(*place) for place in places))[:3]

    def _largest(self, sensors: Sequence[int | str], axes: Sequence[str]) -> int:
        """Return the row with the largest residual in a place; of all rows where there is no place."""
        ratio = np.nan_to_num(self.states[0].ratio)
        is_place = np.zeros(len(ratio), dtype=bool)
        columns = ["xyz".index(axis) for axis in axes] or [0, 1, 2]
        for sensor in sensors:
            is_place[[-1] if sensor == "scalar" else [3 * (int(sensor) - 1) + axis for axis in columns]] = True
        return int(np.argmax(np.where(is_place | ~is_place.any(), ratio, -1.0)))

    def row_name(self, row: int) -> str:
        """Return "sensor 2 x" or "scalar"."""
        return self.states[0].row_name(row)


@page.in_style
def plot_evidence(gap: Gap) -> Figure:
    """Draw the probabilities of the causes, the most probable on top, supported ones in full colour."""
    ranked = sorted(gap.probabilities.items(), key=lambda each: -each[1])
    # Of the causes the others share a few per mille.
    shown = [each for each in ranked[:8] if each[1] >= 1e-3 or each[0] in gap.named] or ranked[:1]
    names, values = [name.replace("_", " ") for name, _ in shown], [value for _, value in shown]
    colors = [page.AFTER_COLOR if name in gap.named else page.QUIET_COLOR for name, _ in shown]
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 0.9 + 0.28 * len(shown))
    axes = figure.subplots()
    axes.barh(names, values, color=colors, height=0.65)
    for place, value in enumerate(values):
        axes.text(value + 0.01, place, percent(value), va="center", fontsize=8)
    axes.set(xlim=(0, 1.1), ylim=(len(shown) - 0.4, -0.6), xlabel="probability, calibrated on simulated recordings")
    axes.tick_params(axis="y", length=0)
    return figure


@page.in_style
def plot_dependence(view: GapView, row: int) -> Figure:
    """Draw one row, in noise floors: its mean over temperature and current, its root mean square over the rate.

    Parameters
    ----------
    view : GapView
        The gap with its residuals; temperature and current are drawn where they were recorded.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    residue = view.gap.residue
    panels: list[tuple[str, FloatArray, Callable[[FloatArray], float], str, float]] = [
        ("rate of turning (°/s)", to_degrees(residue.rate), _root_mean_square, "root mean square", 1.0)
    ]
    for label, channel in (("temperature (°C)", residue.temperature_C), ("current (A)", residue.current_A)):
        if channel is not None:
            panels.append((label, channel, np.mean, "mean", 0.0))
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 2.8)
    places = figure.subplots(1, len(panels), squeeze=False)[0]
    for axes, (label, channel, measure, what, of_noise) in zip(places, panels, strict=True):
        for state in view.states:
            values = state.rows_T[:, row] / residue.floor_T[row]
            axes.plot(*binned(channel, values, measure), ".-", color=state.color, linewidth=1, label=state.name)
        axes.axhline(of_noise, color=page.FLOOR_COLOR, linestyle="dashed", linewidth=0.8)
        axes.set_xlabel(label)
        axes.set_title(what, loc="left", fontsize=8)
    figure.supylabel(f"{view.row_name(row)} (noise floors)")
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    return figure


def binned(
    channel: FloatArray, values: FloatArray, measure: Callable[[FloatArray], float]
) -> tuple[FloatArray, FloatArray]:
    """Return median of the channel and measure of the values in bins of equally many samples.

    Parameters
    ----------
    channel : (N,) array
        What the values may depend on; samples with NaN here or in the values are left out.
    values : (N,) array
        Residuals of one row, in noise floors.
    measure : callable
        Returns one number for the values of a bin.
    """
    order = np.argsort(channel, kind="stable")
    order = order[np.isfinite(channel + values)[order]]
    # Bins of equally many samples: enough to show a curve, few enough that each mean is certain.
    parts = [part for part in np.array_split(order, 12) if len(part)]
    return np.array([np.median(channel[part]) for part in parts]), np.array([measure(values[part]) for part in parts])


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


_SIGNED = LinearSegmentedColormap.from_list("signed", [page.AFTER_COLOR, "#f4f6f8", page.BEFORE_COLOR])
"""Of mean residuals on the sphere, from the least to the largest."""


@page.in_style
def plot_sphere(states: Sequence[State], row: int) -> Figure:
    """Draw mean residuals of a row in each cell of the sphere of field directions (Hammer), a map a state on one scale.

    Parameters
    ----------
    states : sequence of State
        Residuals with the field directions in the array frame; runs may differ.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    means = [cell_means(to_nanotesla(each.rows_T[:, row]), each.residue.direction) for each in states]
    reach = float(np.nanmax(np.abs(means), initial=0.0)) or 1.0
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 2.2)
    plots = figure.subplots(1, len(means), subplot_kw={"projection": "hammer"}, squeeze=False)[0]
    for axes, each, mean in zip(plots, states, means, strict=True):
        mesh = _draw_means(axes, mean, reach)
        axes.set_title(each.name, color=each.color)
    label = f"mean residual of {states[0].row_name(row)} (nT)"
    figure.colorbar(mesh, ax=list(plots), location="bottom", shrink=0.5, aspect=40, label=label)
    return figure


def _draw_means(axes: Axes, means: FloatArray, reach: float) -> QuadMesh:
    """Draw the mean of each cell on a map of the sphere, in shades from −reach to reach."""
    longitude, latitude, cell = cells_on_map()
    shades = np.ma.masked_invalid(means[cell])
    mesh = axes.pcolormesh(
        longitude, latitude, shades, cmap=_SIGNED, vmin=-reach, vmax=reach, shading="nearest", rasterized=True
    )
    draw_borders(axes)
    return mesh


def cell_means(values: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the mean of the known values in each cell of the sphere, NaN where there is none.

    Parameters
    ----------
    values : (N,) array
        NaN where they are not known.
    direction : (N, 3) array
        Of the field, unit vectors.
    """
    known = np.isfinite(values)
    cell = cell_of(direction[known])
    counts = np.bincount(cell, minlength=CELLS)
    sums = np.bincount(cell, values[known], minlength=CELLS)
    return np.asarray(np.divide(sums, counts, out=np.full(CELLS, np.nan), where=counts > 0))


_SHADES = LinearSegmentedColormap.from_list("gap", ["#f4f6f8", page.BEFORE_COLOR, "#5a2f06"])


@page.in_style
def plot_map(view: GapView) -> Figure:
    """Draw root mean squares over the floor, sensors downwards and axes across, one map a state on one scale."""
    states = view.states
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 1.3 + 0.3 * (view.gap.sensor_count + 1))
    largest = np.nanmax([*(np.nanmax(state.ratio, initial=1.0) for state in states), 2.0])
    scale = LogNorm(1.0, largest, clip=True)
    for index, (axes, state) in enumerate(zip(figure.subplots(1, len(states), squeeze=False)[0], states, strict=True)):
        _draw(axes, state, view.gap.sensor_count, scale)
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
        color = "white" if value**2 > float(scale.vmax or 1.0) else page.FLOOR_COLOR
        axes.text(column, row, ratio(value), ha="center", va="center", color=color, fontsize=8)
    axes.set_xticks(range(3), ["x", "y", "z"])
    axes.set_yticks(range(sensor_count + 1), [*(f"sensor {k + 1}" for k in range(sensor_count)), "scalar"])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    axes.set_title(state.name, loc="left", color=state.color)


@page.in_style
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
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 4.2)
    floor = to_nanotesla(float(residue.floor_T[row]))
    panels = [Panel(state.name, to_nanotesla(state.rows_T[:, row]), floor, state.color) for state in view.states]
    seconds = draw_over_time(figure, residue.time_s, panels, "nT")
    if where.time_s is not None:
        span = (np.array(where.time_s) - residue.time_s[0]) / seconds
        for axes in figure.axes:
            axes.axvspan(*span, color=page.MISSING_COLOR, alpha=0.2, linewidth=0)
    return figure


def plot_histogram(states: Sequence[State], row: int) -> Figure:
    """Draw the distributions of one row, all states together, on a logarithmic scale that shows the tails.

    Parameters
    ----------
    states : sequence of State
        Residuals, drawn in noise floors of the last one.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    floor = float(states[-1].residue.floor_T[row])
    drawn = [Panel(state.name, state.rows_T[:, row], floor, state.color) for state in states]
    return plot_distributions(drawn, f"residual of {states[-1].row_name(row)}, in noise floors")


@page.in_style
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
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 3.0)
    axes = figure.subplots()
    floor = float(residue.floor_T[row])
    for state in view.states:
        frequency, amplitude = spectrum(residue.time_s, state.rows_T[:, row] / floor)
        axes.plot(frequency, amplitude, color=state.color, linewidth=1.2, label=state.name)
    axes.axhline(1, color=page.FLOOR_COLOR, linestyle="dashed", linewidth=0.8)
    axes.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"{view.row_name(row)}, in noise floors")
    if where.frequency_hz is not None:
        low, high = axes.get_xlim()
        axes.axvspan(
            max(where.frequency_hz[0], low), min(where.frequency_hz[1], high), color=page.MISSING_COLOR, alpha=0.2
        )
        axes.set_xlim(low, high)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
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


@page.in_style
def plot_course(course: Course) -> Figure:
    """Draw the size of a law over time, and the band of two standard errors on either side."""
    factor, unit = (100.0, "%") if course.unit == "1" else (to_nanotesla(1.0), "nT")
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 2.2)
    axes = figure.subplots()
    seconds, size, error = course.time_s - course.time_s[0], factor * course.size, factor * course.error
    axes.fill_between(seconds, size - 2 * error, size + 2 * error, color=page.BEFORE_COLOR, alpha=0.25, linewidth=0)
    axes.plot(seconds, size, color=page.BEFORE_COLOR)
    axes.set_xlabel("time, s")
    axes.set_ylabel(unit)
    return figure
