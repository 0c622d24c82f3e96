"""Residuals of a gap over what they may depend on: temperature, current, and the rate of turning."""

from collections.abc import Callable

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.report.gap_view import GapView
from tam_calibration.report.style import FLOOR_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.units import FloatArray, to_degrees

_BINS = 12
"""Of equally many samples each: enough to show a bend, few enough that each mean is sure."""


@matplotlib.rc_context(STYLE)
def plot_dependence(view: GapView, row: int) -> Figure:
    """Draw one row, in noise floors: its mean over temperature and current, its root mean square over the rate."""
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
    """Return median of the channel and measure of the values in bins of equally many samples."""
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
