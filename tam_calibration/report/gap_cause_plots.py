"""The causes of a gap drawn: their probabilities and shares, and residuals over what they may depend on."""

from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from tam_calibration.fit.coverage import CELLS, cell_of
from tam_calibration.gap.result import Gap
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla
from tam_calibration.report.gap_rows import percent
from tam_calibration.report.gap_view import GapView
from tam_calibration.report.recording_plots import cells_on_map, draw_borders
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, PAGE_WIDTH_INCH, QUIET_COLOR, STYLE

_SHOWN = 8
"""Causes that are drawn, the most probable ones: the others share a few per mille."""

_LEAST_DRAWN = 1e-3
"""Smallest probability that a figure can show."""


@matplotlib.rc_context(STYLE)
def plot_evidence(gap: Gap) -> Figure:
    """Draw the probabilities of the causes, the most probable on top, supported ones in full colour."""
    supported = {cause.fitted.effect for cause in gap.causes}
    ranked = sorted(gap.probabilities.items(), key=lambda each: -each[1])
    shown = [each for each in ranked[:_SHOWN] if each[1] >= _LEAST_DRAWN or each[0] in supported] or ranked[:1]
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
def plot_shares(gap: Gap) -> Figure:
    """Draw the energy of the gap from all of it to what remains, one step for each cause."""
    closed = gap.size.closed if np.isfinite(gap.size.closed) else 0.0
    steps = [(cause.fitted.effect.replace("_", " "), closed * cause.share) for cause in gap.causes]
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.8), layout="constrained")
    axes = figure.subplots()
    axes.bar(0, 1.0, color=BEFORE_COLOR, width=0.6)
    top = 1.0
    for place, (_, step) in enumerate(steps, start=1):
        axes.bar(place, -step, bottom=top, color=AFTER_COLOR, width=0.6)
        axes.plot([place - 0.7, place + 0.3], [top, top], color=QUIET_COLOR, linewidth=0.6)
        axes.text(place, top - step / 2, f"−{percent(step)}", ha="center", va="center", fontsize=8, color="white")
        top -= step
    axes.bar(len(steps) + 1, max(top, 0.0), color=BEFORE_COLOR, width=0.6)
    axes.text(len(steps) + 1, max(top, 0.0) + 0.02, percent(max(top, 0.0)), ha="center", va="bottom", fontsize=8)
    axes.set_xticks(range(len(steps) + 2), ["the whole gap", *(name for name, _ in steps), "left"])
    axes.set_yticks([0, 0.5, 1], ["0", "50 %", "100 %"])
    axes.set_ylabel("energy above the noise")
    axes.tick_params(axis="x", length=0)
    return figure


_BINS = 12
"""Bins of equally many samples: enough to show a curve, few enough that each mean is certain."""


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
            panels.append((label, channel, _mean, "mean"))
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
    parts = [part for part in np.array_split(order, _BINS) if len(part)]
    channel, values = channel[known], values[known]
    middle = np.array([float(np.median(channel[part])) for part in parts])
    return middle, np.array([measure(values[part]) for part in parts])


def _mean(values: FloatArray) -> float:
    return float(np.mean(values))


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
    longitude, latitude, map_cell = cells_on_map()
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.2), layout="constrained")
    plots = figure.subplots(1, len(means), subplot_kw={"projection": "hammer"}, squeeze=False)[0]
    for axes, each, mean in zip(plots, view.states, means, strict=True):
        shades = np.ma.masked_invalid(mean[map_cell])
        mesh = axes.pcolormesh(
            longitude, latitude, shades, cmap=SHADES, vmin=-reach, vmax=reach, shading="nearest", rasterized=True
        )
        draw_borders(axes)
        axes.set_title(each.name, color=each.color)
    label = f"mean residual of {view.row_name(row)} (nT)"
    figure.colorbar(mesh, ax=list(plots), location="bottom", shrink=0.5, aspect=40, label=label)
    return figure


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
    mean: FloatArray = np.divide(sums, counts, out=np.full(CELLS, np.nan), where=counts > 0)
    return mean
