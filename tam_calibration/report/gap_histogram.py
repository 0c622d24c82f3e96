"""Distribution of the residuals of a gap against the Gaussian of the noise floor."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.report.gap_view import GapView
from tam_calibration.report.style import FLOOR_COLOR, PAGE_WIDTH_INCH, STYLE

_FEWEST_BINS, _MOST_BINS = 21, 81
"""Between which the root of the number of samples is taken."""

_WIDEST_BIN = 0.5
"""Noise floors: wider ones blur the Gaussian of the floor."""

_LOWEST, _HIGHEST = 4.5, 30.0
"""Noise floors to which the axis reaches: past all white noise, and not so far that the floor becomes a line."""


@matplotlib.rc_context(STYLE)
def plot_histogram(view: GapView, row: int) -> Figure:
    """Draw the distributions of one row, all states together, on a logarithmic scale that shows the tails."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 3.0), layout="constrained")
    axes = figure.subplots()
    floor = float(view.gap.residue.floor_T[row])
    samples = [state.rows_T[:, row] / floor for state in view.states]
    known = [values[np.isfinite(values)] for values in samples]
    reach = float(np.clip(max(np.max(np.abs(values), initial=0.0) for values in known), _LOWEST, _HIGHEST))
    bins = int(max(np.clip(np.sqrt(len(known[0])), _FEWEST_BINS, _MOST_BINS), 2 * reach / _WIDEST_BIN))
    for state, values in zip(view.states, known, strict=True):
        counts, edges = np.histogram(np.clip(values, -reach, reach), bins, range=(-reach, reach))
        density = counts / (max(len(values), 1) * (edges[1] - edges[0]))
        axes.stairs(density, edges, color=state.color, linewidth=1.4, label=state.name)
    x = np.linspace(-reach, reach, 401)
    gaussian = np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi)
    axes.plot(x, gaussian, color=FLOOR_COLOR, linestyle="dashed", linewidth=0.9, label="noise floor alone")
    axes.set(yscale="log", xlabel=f"residual of {view.row_name(row)}, in noise floors", ylabel="probability density")
    axes.set_ylim(0.3 / (max(len(known[0]), 1) * (2 * reach / bins)), 1.5)
    axes.legend(frameon=False, fontsize=8)
    return figure
