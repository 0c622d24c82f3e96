"""Spectra of the residuals of a gap, in noise floors: white noise of the floor's size is 1 at every frequency."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from tam_calibration.report.gap_view import GapView
from tam_calibration.report.style import FLOOR_COLOR, MISSING_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.units import FloatArray

_BANDS = 250
"""Evenly in the logarithm of the frequency: about one for each three points of the page."""

_LONGEST = 1 << 21
"""Points of the grid, six hours at 100 Hz: a record with longer holes is not put on one."""


@matplotlib.rc_context(STYLE)
def plot_spectrum(view: GapView, row: int) -> Figure:
    """Draw the amplitude spectrum of one row, all states together; the band of the gap is shaded."""
    residue, where = view.gap.residue, view.gap.where
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 3.0), layout="constrained")
    axes = figure.subplots()
    floor = float(residue.floor_T[row])
    for state in view.states:
        frequency, amplitude = spectrum(residue.time_s, state.rows_T[:, row] / floor)
        axes.plot(frequency, amplitude, color=state.color, linewidth=1.2, label=state.name)
    axes.axhline(1, color=FLOOR_COLOR, linestyle="dashed", linewidth=0.8)
    axes.set(xscale="log", yscale="log", xlabel="frequency (Hz)", ylabel=f"{view.row_name(row)}, in noise floors")
    if where.frequency_hz is not None:
        low, high = axes.get_xlim()
        axes.axvspan(max(where.frequency_hz[0], low), min(where.frequency_hz[1], high), color=MISSING_COLOR, alpha=0.2)
        axes.set_xlim(low, high)
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.legend(frameon=False, fontsize=8)
    return figure


def spectrum(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return frequencies (Hz) and amplitudes of a series with holes, averaged over bands; white unit noise gives 1.

    The samples are put on a grid of their median step, empty places are zero; where that would be too long, the
    samples are taken as if they followed one another at that step.
    """
    step = float(np.median(np.diff(time_s)))
    place = np.rint((time_s - time_s[0]) / step).astype(int)
    if place[-1] >= _LONGEST:
        place = np.arange(len(time_s))
    known = np.isfinite(values)
    grid = np.zeros(place[-1] + 1)
    grid[place[known]] = values[known]
    power = np.abs(np.fft.rfft(grid)[1:]) ** 2 / max(int(known.sum()), 1)
    frequency = np.fft.rfftfreq(len(grid), step)[1:]
    band = np.digitize(frequency, np.geomspace(frequency[0], frequency[-1], _BANDS)[1:-1])
    counts = np.bincount(band)
    filled = counts > 0
    centers = np.bincount(band, frequency)[filled] / counts[filled]
    return centers, np.sqrt(np.bincount(band, power)[filled] / counts[filled])
