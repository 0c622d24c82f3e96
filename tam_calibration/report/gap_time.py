"""Residuals of a gap over time: the recording, the same without its causes, and its simulated twin."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.report.formatting import number
from tam_calibration.report.gap_view import GapView
from tam_calibration.report.residual_plots import draw_series, time_axis
from tam_calibration.report.style import FLOOR_COLOR, MISSING_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.units import to_nanotesla


@matplotlib.rc_context(STYLE)
def plot_time(view: GapView, row: int) -> Figure:
    """Draw the residual of one row over time, one panel a state on common axes; the span of the gap is shaded."""
    residue, where = view.gap.residue, view.gap.where
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 4.2), layout="constrained")
    panels = figure.subplots(len(view.states), 1, sharex=True, sharey=True, squeeze=False)[:, 0]
    elapsed = residue.time_s - residue.time_s[0]
    unit, seconds = time_axis(float(elapsed[-1]))
    floor = to_nanotesla(float(residue.floor_T[row]))
    for axes, state in zip(panels, view.states, strict=True):
        draw_series(axes, elapsed / seconds, to_nanotesla(state.rows_T[:, row]), state.color)
        axes.hlines([-floor, floor], 0, elapsed[-1] / seconds, FLOOR_COLOR, "dashed", linewidth=0.8)
        if where.time_s is not None:
            span = (np.array(where.time_s) - residue.time_s[0]) / seconds
            axes.axvspan(*span, color=MISSING_COLOR, alpha=0.2, linewidth=0)
        axes.set_title(state.name, loc="left", color=state.color)
        axes.set_title(f"RMS {number(float(state.ratio[row]))} × floor", loc="right", fontsize=8)
        axes.margins(x=0.01)
    panels[-1].set_xlabel(f"time from the first sample ({unit})")
    figure.supylabel(f"residual of {view.row_name(row)} (nT)")
    return figure
