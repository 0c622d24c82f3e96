"""A simulation and a recording drawn over each other: noise, residuals, the closing of the gap, source errors."""

from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from tam_calibration.comparison.result import AxisNoise, Closing, NoiseDifference, Side
from tam_calibration.fit.coverage import cell_directions
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report.comparison_rows import axis_name, source_errors
from tam_calibration.report.formatting import number
from tam_calibration.report.gap_cause_plots import SHADES, cell_means
from tam_calibration.report.gap_residual_plots import Distribution, plot_distributions
from tam_calibration.report.recording_plots import cells_on_map, draw_borders
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, MISSING_COLOR, PAGE_WIDTH_INCH, QUIET_COLOR, STYLE

SIMULATION_COLOR, RECORDING_COLOR = AFTER_COLOR, BEFORE_COLOR
"""Of the two columns, on all figures."""

_COLORS = {"simulation": SIMULATION_COLOR, "recording": RECORDING_COLOR, "mended simulation": QUIET_COLOR}


@matplotlib.rc_context(STYLE)
def plot_noise(noise: NoiseDifference) -> Figure:
    """Draw the spectra of an axis's noise over each other, with their 95 % intervals."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 3.0), layout="constrained")
    axes = figure.subplots()
    _draw_noise(axes, noise, _range([noise]))
    axes.set(xlabel="frequency (Hz)", ylabel=f"noise of {axis_name(noise.recording)} (nT/√Hz)")
    axes.legend(frameon=False, fontsize=8)
    return figure


@matplotlib.rc_context(STYLE)
def plot_all_noise(noise: Sequence[NoiseDifference]) -> Figure:
    """Draw the spectra of all axes small, those of sensors on one scale; what differs has a shaded ground."""
    columns = 3
    rows = -(-len(noise) // columns)
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 0.6 + 1.1 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    common = _range([each for each in noise if each.recording.sensor])
    for axes, each in zip(panels.ravel(), noise, strict=False):
        _draw_noise(axes, each, common if each.recording.sensor else _range([each]))
        axes.set_title(f"{axis_name(each.recording)}{': differs' if each.differs else ''}", loc="left", fontsize=8)
        if each.differs:
            axes.set_facecolor(f"{MISSING_COLOR}22")
    for axes in panels[:, 1:].ravel():
        axes.tick_params(labelleft=False)
    for axes in panels.ravel()[len(noise) :]:
        axes.remove()
    figure.supxlabel("frequency (Hz)")
    figure.supylabel("noise (nT/√Hz)")
    return figure


_LEAST_SHOWN = 10**0.6
"""Least ratio of an end of the axis to its middle: more than a decade, so that there is a tick with a number."""


def _range(noise: Sequence[NoiseDifference]) -> tuple[float, float]:
    """Return the ends of a logarithmic axis, nT/√Hz, that shows the spectra of all but of what has no noise."""
    sides = [side for each in noise for side in (each.simulation, each.recording)]
    bounds = [
        _amplitude(side, density)
        for side in sides
        for density in (side.density_low_T2_per_hz, side.density_high_T2_per_hz)
    ]
    drawn = np.concatenate([each[each > 0] for each in bounds])
    low, high = (float(drawn.min()), float(drawn.max())) if len(drawn) else (1.0, 1.0)
    middle = np.sqrt(low * high)
    return min(low, middle / _LEAST_SHOWN), max(high, middle * _LEAST_SHOWN)


def _amplitude(noise: AxisNoise, density: FloatArray) -> FloatArray:
    """Return the root of a density of an axis's noise, nT/√Hz, but for the constant part."""
    amplitude: FloatArray = to_nanotesla(np.sqrt(density[noise.frequency_hz > 0]))
    return amplitude


def _draw_noise(axes: Axes, noise: NoiseDifference, ends: tuple[float, float]) -> None:
    for name, side in (("simulation", noise.simulation), ("recording", noise.recording)):
        frequency = side.frequency_hz[side.frequency_hz > 0]
        low, high = (_amplitude(side, each) for each in (side.density_low_T2_per_hz, side.density_high_T2_per_hz))
        axes.fill_between(frequency, low, high, color=_COLORS[name], alpha=0.25, linewidth=0)
        axes.plot(frequency, _amplitude(side, side.density_T2_per_hz), color=_COLORS[name], linewidth=1.1, label=name)
    axes.set(xscale="log", yscale="log", ylim=ends)
    axes.minorticks_off()
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))


def row_to_draw(simulation: Side, recording: Side) -> int:
    """Return the row whose residuals differ most in size: 3 i + a for axis a of sensor i, both from 0; 3K the scalar.

    Parameters
    ----------
    simulation, recording : Side
        Of arrays with equally many sensors.
    """
    sizes = [_root_mean_square(side.gap.residue.before) for side in (simulation, recording)]
    is_known = np.isfinite(sizes).all(axis=0) & (np.min(sizes, axis=0) > 0)
    ratio = np.divide(sizes[1], sizes[0], out=np.ones(len(sizes[0])), where=is_known)
    return int(np.argmax(np.abs(np.log(ratio))))


def _root_mean_square(rows: FloatArray) -> FloatArray:
    known = np.isfinite(rows)
    squares = np.sum(np.where(known, rows, 0.0) ** 2, axis=0)
    size: FloatArray = np.sqrt(squares / np.maximum(known.sum(axis=0), 1))
    return size


@matplotlib.rc_context(STYLE)
def plot_sphere(simulation: Side, recording: Side, row: int, name: str) -> Figure:
    """Draw mean residuals of one row over the directions of the field: the simulation's as dots on the recording's.

    Parameters
    ----------
    simulation, recording : Side
        With the residuals that a calibration leaves.
    row : int
        As ``row_to_draw`` returns it.
    name : str
        Of the row.
    """
    dots, ground = (
        cell_means(to_nanotesla(side.gap.residue.before[:, row]), side.gap.residue.direction)
        for side in (simulation, recording)
    )
    reach = float(np.nanmax(np.abs([dots, ground]), initial=0.0)) or 1.0
    shades: dict[str, Any] = {"cmap": SHADES, "vmin": -reach, "vmax": reach}
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 3.8), layout="constrained")
    axes = figure.add_subplot(projection="hammer")
    longitude, latitude, cell = cells_on_map()
    mesh = axes.pcolormesh(
        longitude, latitude, np.ma.masked_invalid(ground[cell]), shading="nearest", rasterized=True, **shades
    )
    draw_borders(axes)
    x, y, z = cell_directions()[np.isfinite(dots)].T
    axes.scatter(
        -np.arctan2(y, x), np.arcsin(z), 45, dots[np.isfinite(dots)], edgecolors=QUIET_COLOR, linewidths=0.5, **shades
    )
    label = f"mean residual of {name} (nT): ground recording, dots simulation"
    figure.colorbar(mesh, ax=axes, location="bottom", shrink=0.5, aspect=40, label=label)
    return figure


def plot_histograms(simulation: Side, recording: Side, row: int, name: str) -> Figure:
    """Draw the distributions of one row's residuals over each other, in noise floors of the recording.

    Parameters
    ----------
    simulation, recording : Side
        With the residuals that a calibration leaves.
    row : int
        As ``row_to_draw`` returns it.
    name : str
        Of the row.
    """
    floor = float(recording.gap.residue.floor_T[row])
    sides = {"simulation": simulation, "recording": recording}
    drawn = [Distribution(side, _COLORS[side], each.gap.residue.before[:, row] / floor) for side, each in sides.items()]
    return plot_distributions(drawn, f"residual of {name}, in noise floors of the recording")


@matplotlib.rc_context(STYLE)
def plot_steps(closing: Closing) -> Figure:
    """Draw the gap as it is, and what each further term of the mend leaves of it."""
    names = ["simulation as it is", *(f"mended: {step.added.replace('_', ' ')}" for step in closing.steps)]
    values = [closing.before, *(step.left for step in closing.steps)]
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 0.9 + 0.3 * len(names)), layout="constrained")
    axes = figure.subplots()
    places = range(len(names))
    axes.barh(places, values, color=[BEFORE_COLOR, *[AFTER_COLOR] * len(closing.steps)], height=0.65)
    for place, value in zip(places, values, strict=True):
        axes.text(value, place, f" {number(value)}", va="center", fontsize=8)
    axes.set_yticks(places, names)
    axes.set(ylim=(len(names) - 0.4, -0.6), xlabel="gap to the recording (noise floors)")
    axes.margins(x=0.12)
    axes.tick_params(axis="y", length=0)
    return figure


@matplotlib.rc_context(STYLE)
def plot_source_errors(closing: Closing) -> Figure:
    """Draw how far from a source that is put in ``tam locate`` ends, with 95 % intervals."""
    errors = source_errors(closing)
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 0.8 + 0.35 * len(errors)), layout="constrained")
    axes = figure.subplots()
    for place, (name, error) in enumerate(errors):
        axes.plot(error.interval_m, [place, place], color=_COLORS[name], linewidth=2)
        axes.plot(error.median_m, place, "o", color=_COLORS[name], markersize=6)
    axes.set_yticks(range(len(errors)), [name for name, _ in errors])
    axes.set(ylim=(len(errors) - 0.5, -0.5), xlabel="distance from the true source (m)")
    axes.set_xlim(left=0)
    axes.tick_params(axis="y", length=0)
    return figure
