"""Mean residuals of a gap over the directions of the field."""

import matplotlib
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from tam_calibration.fit.coverage import CELLS, IntArray, cell_of
from tam_calibration.report.coverage_map import cells_on_map, draw_borders
from tam_calibration.report.gap_view import GapView
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.units import FloatArray, to_nanotesla

_SHADES = LinearSegmentedColormap.from_list("signed", [AFTER_COLOR, "#f4f6f8", BEFORE_COLOR])


@matplotlib.rc_context(STYLE)
def plot_sphere(view: GapView, row: int) -> Figure:
    """Draw the mean residual of one row in each cell of the sphere of field directions (Hammer), one map a state."""
    states, cell = view.states, cell_of(view.gap.residue.direction)
    means = [cell_means(to_nanotesla(state.rows_T[:, row]), cell) for state in states]
    reach = float(np.nanmax(np.abs(means), initial=0.0)) or 1.0
    longitude, latitude, map_cell = cells_on_map()
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 2.2), layout="constrained")
    plots = figure.subplots(1, len(states), subplot_kw={"projection": "hammer"}, squeeze=False)[0]
    for axes, state, mean in zip(plots, states, means, strict=True):
        shades = np.ma.masked_invalid(mean[map_cell])
        mesh = axes.pcolormesh(
            longitude, latitude, shades, cmap=_SHADES, vmin=-reach, vmax=reach, shading="nearest", rasterized=True
        )
        draw_borders(axes)
        axes.set_title(state.name, color=state.color)
    label = f"mean residual of {view.row_name(row)} (nT)"
    figure.colorbar(mesh, ax=list(plots), location="bottom", shrink=0.5, aspect=40, label=label)
    return figure


def cell_means(values: FloatArray, cell: IntArray) -> FloatArray:
    """Return the mean of the known values in each cell, NaN where there is none."""
    known = np.isfinite(values)
    counts = np.bincount(cell[known], minlength=CELLS)
    sums = np.bincount(cell[known], values[known], minlength=CELLS)
    mean: FloatArray = np.divide(sums, counts, out=np.full(CELLS, np.nan), where=counts > 0)
    return mean
