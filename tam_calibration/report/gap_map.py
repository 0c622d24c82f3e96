"""The map of where: residuals of every sensor, axis and the scalar against their noise floors."""

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap, LogNorm
from matplotlib.figure import Figure

from tam_calibration.report.formatting import ratio
from tam_calibration.report.gap_view import GapView, State
from tam_calibration.report.style import BEFORE_COLOR, FLOOR_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.units import FloatArray

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
