"""The causes of a gap drawn: their probabilities and shares, and residuals over what they may depend on."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from tam_calibration.fit.coverage import CELLS, cell_of
from tam_calibration.gap.result import Gap
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla
from tam_calibration.report.gap_rows import percent
from tam_calibration.report.page import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, PAGE_WIDTH_INCH, QUIET_COLOR, STYLE
from tam_calibration.report.recording_plots import cells_on_map, draw_borders


@dataclass(frozen=True, eq=False)
class State:
    """Residuals (N, 3K + 1) of one kind, tesla: its name, its colour, and their root mean squares over the floor."""

    name: str
    color: str
    rows_T: FloatArray
    ratio: FloatArray


@dataclass(frozen=True, eq=False)
class GapView:
    """A gap as its figures show it."""

    gap: Gap

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self.gap.residue.floor_T) // 3

    @cached_property
    def states(self) -> tuple[State, ...]:
        """The recording, the recording without its causes where there are any, and the twin."""
        residue = self.gap.residue
        kinds = [("recording", BEFORE_COLOR, residue.before)]
        if self.gap.causes:
            kinds.append(("without its causes", AFTER_COLOR, residue.after))
        kinds.append(("simulated twin", QUIET_COLOR, residue.twin))
        return tuple(State(name, color, rows, self._ratio(rows)) for name, color, rows in kinds)

    def _ratio(self, rows_T: FloatArray) -> FloatArray:
        """Return the root mean squares of rows over the floor, NaN for a row without information."""
        known = np.isfinite(rows_T) & (rows_T != 0)
        squares = np.sum(np.where(known, rows_T, 0.0) ** 2, axis=0) / np.maximum(known.sum(axis=0), 1)
        floor = self.gap.residue.floor_T
        is_known = known.any(axis=0) & np.isfinite(floor) & (floor > 0)
        return np.asarray(np.divide(np.sqrt(squares), floor, out=np.full(len(floor), np.nan), where=is_known))

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
        return "scalar" if row == 3 * self.sensor_count else f"sensor {row // 3 + 1} {'xyz'[row % 3]}"


@matplotlib.rc_context(STYLE)
def plot_evidence(gap: Gap) -> Figure:
    """Draw the probabilities of the causes, the most probable on top, supported ones in full colour."""
    supported = {cause.fitted.effect for cause in gap.causes}
    ranked = sorted(gap.probabilities.items(), key=lambda each: -each[1])
    # Of the causes the others share a few per mille.
    shown = [each for each in ranked[:8] if each[1] >= 1e-3 or each[0] in supported] or ranked[:1]
    names, values = [name.replace("_", " ") for name, _ in shown], [value for _, value in shown]
    colors = [AFTER_COLOR if name in supported else QUIET_COLOR for name, _ in shown]
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 0.9 + 0.28 * len(shown)), layout="constrained")
    axes = figure.subplots()
    axes.barh(names, values, color=colors, height=0.65)
    for place, value in enumerate(values):
        axes.text(value + 0.01, place, percent(value), va="center", fontsize=8)
    axes.set(xlim=(0, 1.1), ylim=(len(shown) - 0.4, -0.6), xlabel="probability, calibrated on simulated recordings")
    axes.tick_params(axis="y", length=0)
    return figure


@matplotlib.rc_context(STYLE)
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
    panels: list[tuple[str, FloatArray, Callable[[FloatArray], float], str]] = [
        ("rate of turning (°/s)", to_degrees(residue.rate), _root_mean_square, "root mean square")
    ]
    for label, channel in (("temperature (°C)", residue.temperature_C), ("current (A)", residue.current_A)):
        if channel is not None:
            panels.append((label, channel, np.mean, "mean"))
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.8), layout="constrained")
    for axes, (label, channel, measure, what) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        for state in view.states:
            values = state.rows_T[:, row] / residue.floor_T[row]
            axes.plot(*binned(channel, values, measure), ".-", color=state.color, linewidth=1, label=state.name)
        axes.axhline(1 if measure is _root_mean_square else 0, color=FLOOR_COLOR, linestyle="dashed", linewidth=0.8)
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
    known = np.isfinite(channel) & np.isfinite(values)
    order = np.argsort(channel[known], kind="stable")
    # Bins of equally many samples: enough to show a curve, few enough that each mean is certain.
    parts = [part for part in np.array_split(order, 12) if len(part)]
    channel, values = channel[known], values[known]
    middle = np.array([float(np.median(channel[part])) for part in parts])
    return middle, np.array([measure(values[part]) for part in parts])


def _root_mean_square(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


SHADES = LinearSegmentedColormap.from_list("signed", [AFTER_COLOR, "#f4f6f8", BEFORE_COLOR])
"""Of mean residuals on the sphere, from the least to the largest."""


@matplotlib.rc_context(STYLE)
def plot_sphere(view: GapView, row: int) -> Figure:
    """Draw mean residuals of a row in each cell of the sphere of field directions (Hammer), a map a state on one scale.

    Parameters
    ----------
    view : GapView
        The gap with its residuals and the field directions in the array frame.
    row : int
        3 i + a for axis a of sensor i, both from 0; 3K for the scalar.
    """
    means = [cell_means(to_nanotesla(each.rows_T[:, row]), view.gap.residue.direction) for each in view.states]
    reach = float(np.nanmax(np.abs(means), initial=0.0)) or 1.0
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.2), layout="constrained")
    plots = figure.subplots(1, len(means), subplot_kw={"projection": "hammer"}, squeeze=False)[0]
    for axes, each, mean in zip(plots, view.states, means, strict=True):
        mesh = draw_means(axes, mean, reach)
        axes.set_title(each.name, color=each.color)
    label = f"mean residual of {view.row_name(row)} (nT)"
    figure.colorbar(mesh, ax=list(plots), location="bottom", shrink=0.5, aspect=40, label=label)
    return figure


def draw_means(axes: Axes, means: FloatArray, reach: float) -> QuadMesh:
    """Draw the mean of each cell on a map of the sphere, in shades from −reach to reach.

    Parameters
    ----------
    axes : Axes
        Of the projection "hammer".
    means : (CELLS,) array
        NaN where there is none.
    reach : float
        Of the scale, in the unit of the means.
    """
    longitude, latitude, cell = cells_on_map()
    shades = np.ma.masked_invalid(means[cell])
    mesh = axes.pcolormesh(
        longitude, latitude, shades, cmap=SHADES, vmin=-reach, vmax=reach, shading="nearest", rasterized=True
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
