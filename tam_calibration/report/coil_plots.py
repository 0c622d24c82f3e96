"""The coil of Wu 2025 Fig. 12 on a page: what each error that the paper's model leaves out does to the distance."""

from collections.abc import Sequence

import matplotlib
from matplotlib.figure import Figure

from tam_calibration.report.formatting import number
from tam_calibration.report.page import Block, Section, Table, Text, embed
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, STYLE, WIDTH_INCH
from tam_calibration.reproduce.wu2025_coil import PRINTED_M
from tam_calibration.reproduce.wu2025_coil_sweeps import CoilSweep

_INTRODUCTION = (
    "The paper locates the coil no better than to 0.25 m after calibration, where its own model leaves 0.00 to 0.08 m. "
    "Each error that the model leaves out is grown by itself: the line is the median over directions of the coil and "
    "shapes of the error, the band holds all of them."
)
_COLUMNS, _PANEL_INCH = 2, 2.0


def coil_section(sweeps: Sequence[CoilSweep]) -> Section:
    """Return the section of a page with a plot of the sweeps, and the size that each error needs."""
    caption = "RMS error of the distance after calibration over the size of one error; dashed as printed"
    needed = [[sweep.name, sweep.unit, _needed(sweep)] for sweep in sweeps]
    blocks: list[Block] = [
        Text(_INTRODUCTION),
        embed(plot_coil_sweeps(sweeps), caption, caption),
        Table(["error", "unit", "needed for the printed distance"], needed),
    ]
    return Section("What the coil of Wu 2025 needs", blocks)


@matplotlib.rc_context(STYLE)
def plot_coil_sweeps(sweeps: Sequence[CoilSweep]) -> Figure:
    """Draw the error of the distance over the size of each error."""
    lines = -(-len(sweeps) // _COLUMNS)
    figure = Figure(figsize=(1.5 * WIDTH_INCH, lines * _PANEL_INCH), layout="constrained")
    for axes, sweep in zip(figure.subplots(lines, _COLUMNS, squeeze=False).flat, sweeps, strict=False):
        least, median, most = sweep.distance_rmse_m.T
        axes.fill_between(sweep.size, least, most, color=AFTER_COLOR, alpha=0.15, linewidth=0)
        axes.plot(sweep.size, median, color=AFTER_COLOR, marker=".", linewidth=1.4)
        for stage, color in (("before", BEFORE_COLOR), ("after", FLOOR_COLOR)):
            axes.axhline(PRINTED_M[stage]["r"], color=color, linestyle="--", linewidth=0.8)
            axes.annotate(stage, (sweep.size[0], PRINTED_M[stage]["r"]), (2, 2), textcoords="offset points", fontsize=7)
        axes.set_ylim(0, 0.6)
        axes.set_title(sweep.name, loc="left")
        axes.set_xlabel(sweep.unit)
    figure.supylabel("r (m)")
    return figure


def _needed(sweep: CoilSweep) -> str:
    return number(sweep.needed) if sweep.needed == sweep.needed else f"more than {number(float(abs(sweep.size).max()))}"
