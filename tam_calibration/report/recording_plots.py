"""Figures of a recording: the field directions that it visited, and residuals over time and by size."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, ListedColormap, LogNorm, to_rgb
from matplotlib.figure import Figure, FigureBase
from matplotlib.patches import Patch
from matplotlib.patheffects import withStroke

from tam_calibration.fit.coverage import BANDS, SECTORS, Coverage, cell_of
from tam_calibration.model.array import OUTPUT_NAMES, TENSOR_OUTPUTS
from tam_calibration.model.sensor_errors import Residuals, ResidualSeries
from tam_calibration.model.units import FloatArray, from_degrees, to_nanotesla
from tam_calibration.report import page
from tam_calibration.report.blocks import count, number

_SHADES = LinearSegmentedColormap.from_list("samples", ["#d3e3f1", page.AFTER_COLOR, "#0d2c4b"])
_MISSING = ListedColormap([page.MISSING_COLOR])


@page.in_style
def plot_coverage(coverage: Coverage) -> Figure:
    """Draw the samples in each cell of the sphere of field directions, equal in area (Hammer), seen from the array.

    Left of the array (+y) is left of the map; cells without a sample stand out.
    """
    figure = page.new_figure(1.3 * page.WIDTH_INCH, 3.8)
    draw_coverage(figure, coverage)
    return figure


def draw_coverage(figure: FigureBase, coverage: Coverage) -> None:
    """Draw what ``plot_coverage`` does into a figure, or a part of one."""
    axes = figure.add_subplot(projection="hammer")
    longitude, latitude, cell = cells_on_map()
    samples = coverage.counts[cell]
    visited = np.ma.masked_where(samples == 0, samples)
    missing = np.ma.masked_where(samples > 0, samples)
    scale = LogNorm(1, max(10, int(coverage.counts.max())))
    mesh = axes.pcolormesh(longitude, latitude, visited, cmap=_SHADES, norm=scale, shading="nearest", rasterized=True)
    axes.pcolormesh(longitude, latitude, missing, cmap=_MISSING, shading="nearest", rasterized=True)
    draw_borders(axes)
    _name_directions(axes)
    figure.colorbar(mesh, ax=axes, location="bottom", shrink=0.5, aspect=30, label="samples in a cell", format="%d")
    key = [Patch(color=page.MISSING_COLOR, label="no sample")]
    axes.legend(handles=key, loc="upper right", bbox_to_anchor=(1.02, 1.05), frameon=False)


def cells_on_map() -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Return the map's longitude, to the right, its latitude, and the cell at each of its points."""
    longitude, latitude = np.linspace(-np.pi, np.pi, 721), np.linspace(-np.pi / 2, np.pi / 2, 361)
    azimuth, elevation = np.meshgrid(-longitude, latitude)
    level = np.cos(elevation)
    points = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=-1)
    return longitude, latitude, cell_of(points.reshape(-1, 3)).reshape(azimuth.shape)


def draw_borders(axes: Axes) -> None:
    """Draw the borders of the cells."""
    along = np.linspace(-1, 1, 181)
    for meridian in np.linspace(-np.pi, np.pi, SECTORS + 1)[1:-1]:
        axes.plot(np.full_like(along, meridian), along * np.pi / 2, color="white", linewidth=0.5)
    for parallel in np.arcsin(np.linspace(-1, 1, BANDS + 1)[1:-1]):
        axes.plot(along * np.pi, np.full_like(along, parallel), color="white", linewidth=0.5)
    axes.set_xticks([])
    axes.set_yticks([])


def _name_directions(axes: Axes) -> None:
    """Write the names of directions on the map."""
    halo = [withStroke(linewidth=2.5, foreground="white")]
    for name, longitude, latitude in (
        ("forward", 0, 0),
        ("left", -90, 0),
        ("right", 90, 0),
        ("backward", -158, 0),
        ("backward", 158, 0),
        ("up", 0, 80),
        ("down", 0, -80),
    ):
        axes.text(from_degrees(longitude), from_degrees(latitude), name, ha="center", va="center", path_effects=halo)


_DRAWN_SINGLY = 4000


@dataclass(frozen=True, eq=False)
class Panel:
    """One residual to draw: its name, its values (N,) with NaN where there is none, its noise floor, in one unit."""

    name: str
    values: FloatArray
    floor: float
    color: str = page.AFTER_COLOR

    @property
    def known(self) -> FloatArray:
        """The values that are not NaN."""
        return self.values[np.isfinite(self.values)]


def thinning_note(sample_count: int) -> str:
    """Say how so many samples are thinned for display over time; empty where every sample is drawn."""
    if sample_count <= _DRAWN_SINGLY:
        return ""
    size = count(_stroke_size(sample_count))
    return f"Thinned for display: each stroke spans the smallest to the largest of {size} consecutive samples."


@page.in_style
def plot_over_time(time_s: FloatArray, panels: Sequence[Panel], unit: str) -> Figure:
    """Draw residuals over time, one row a panel on common axes, with dashed lines at ± the noise floor.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, seconds.
    panels : sequence of Panel
        Residuals with their noise floors.
    unit : str
        Unit of all residuals.
    """
    figure = page.new_figure(page.WIDTH_INCH, height_inch(panels))
    draw_over_time(figure, time_s, panels, unit)
    return figure


def height_inch(panels: Sequence[Panel]) -> float:
    """Return the height of ``plot_over_time`` with these panels, inches."""
    return 0.75 + 0.95 * len(panels)


def draw_over_time(figure: FigureBase, time_s: FloatArray, panels: Sequence[Panel], unit: str) -> float:
    """Draw what ``plot_over_time`` does into a figure, or a part of one; return the seconds of a unit of its time."""
    rows = figure.subplots(len(panels), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    elapsed = time_s - time_s[0]
    time_unit, seconds = time_axis(float(elapsed[-1]))
    for axes, panel in zip(rows, panels, strict=True):
        draw_series(axes, elapsed / seconds, panel.values, panel.color)
        axes.hlines([-panel.floor, panel.floor], 0, elapsed[-1] / seconds, page.FLOOR_COLOR, "dashed", linewidth=0.8)
        axes.set_title(panel.name, loc="left", color=panel.color)
        size = float(np.sqrt(np.mean(panel.known**2))) if len(panel.known) else np.nan
        axes.set_title(f"RMS {number(size)} {unit}", loc="right")
        axes.margins(x=0.01)
    rows[-1].set_xlabel(f"time from the first sample ({time_unit})")
    figure.supylabel(f"residual ({unit})")
    return seconds


@page.in_style
def plot_distributions(panels: Sequence[Panel], label: str) -> Figure:
    """Draw distributions over each other, in noise floors, on a logarithmic scale, beside that of unit noise.

    Parameters
    ----------
    panels : sequence of Panel
        Residuals with their noise floors; the number of bins goes with the samples of the first.
    label : str
        Of the axis.
    """
    figure = page.new_figure(page.PAGE_WIDTH_INCH, 3.0)
    axes = figure.subplots()
    known = [panel.known / panel.floor for panel in panels]
    # The axis goes beyond white noise, but not so far that the floor is no longer visible.
    reach = float(np.clip(max(np.max(np.abs(values), initial=0.0) for values in known), 4.5, 30.0))
    bins = int(max(np.clip(np.sqrt(len(known[0])), 21, 81), 4 * reach))
    for panel, values in zip(panels, known, strict=True):
        counts, edges = np.histogram(np.clip(values, -reach, reach), bins, range=(-reach, reach))
        density = counts / (max(len(values), 1) * (edges[1] - edges[0]))
        axes.stairs(density, edges, color=panel.color, linewidth=1.4, label=panel.name)
    x = np.linspace(-reach, reach, 401)
    gaussian = np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    axes.plot(x, gaussian, color=page.FLOOR_COLOR, linestyle="dashed", linewidth=0.9, label="noise floor alone")
    axes.set(yscale="log", xlabel=label, ylabel="probability density")
    axes.set_ylim(0.3 / (max(len(known[0]), 1) * (2 * reach / bins)), 1.5)
    axes.legend(frameon=False, fontsize=8)
    return figure


def _stroke_size(sample_count: int) -> int:
    return -(-sample_count // 1000)


def time_axis(span_s: float) -> tuple[str, float]:
    """Return the unit in which a span of time is drawn, and how many seconds it has."""
    if span_s <= 600:
        return "s", 1.0
    return ("min", 60.0) if span_s <= 3 * 3600 else ("h", 3600.0)


def draw_series(axes: Axes, time: FloatArray, values: FloatArray, color: str) -> None:
    """Draw values over time, as strokes from the smallest to the largest where there are many.

    Parameters
    ----------
    axes : Axes
        Where to draw.
    time : (N,) array
        In the unit of the axis.
    values : (N,) array
        NaN where there is none.
    color : str
        As matplotlib names it; strokes are paler.
    """
    if len(values) <= _DRAWN_SINGLY:
        axes.plot(time, values, ".", color=color, markersize=2, rasterized=True)
        return
    starts = np.arange(0, len(values), _stroke_size(len(values)))
    low, high = np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts)
    pale = 0.4 + 0.6 * np.array(to_rgb(color))
    axes.vlines(time[starts], low, high, color=pale, linewidth=0.8, rasterized=True)


def intensity_panels(series: ResidualSeries, floor: Residuals, color: str) -> list[Panel]:
    """Return a panel of |B| − reference, nT, for each sensor and, of more than one, for their centre.

    Parameters
    ----------
    series : ResidualSeries
        Residuals of N samples of K sensors.
    floor : Residuals
        Their root mean squares from noise alone.
    color : str
        As matplotlib names it.
    """
    sensors = zip(series.sensor_intensity_T.T, floor.sensor_intensity_T, strict=True)
    panels = [
        Panel(f"sensor {i + 1}", to_nanotesla(values), to_nanotesla(float(noise)), color)
        for i, (values, noise) in enumerate(sensors)
    ]
    if len(panels) > 1:
        center = to_nanotesla(series.center_intensity_T), to_nanotesla(floor.center_intensity_T)
        panels.append(Panel("centre", *center, color))
    return panels


def tensor_panels(series: ResidualSeries, floor: Residuals, color: str) -> list[Panel]:
    """Return a panel for each independent component of the gradient tensor, nT/m: xx, xy, xz, yy, yz.

    Parameters
    ----------
    series : ResidualSeries
        Residuals of N samples.
    floor : Residuals
        Their root mean squares from noise alone.
    color : str
        As matplotlib names it.
    """
    names = [OUTPUT_NAMES[output][1:] for output in TENSOR_OUTPUTS]
    components = zip(names, series.tensor_T_per_m.T, floor.tensor_T_per_m, strict=True)
    return [Panel(name, to_nanotesla(values), to_nanotesla(float(noise)), color) for name, values, noise in components]
