"""The figures of Wu 2025 redrawn: errors and residuals over what is swept."""

from typing import Literal

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, MISSING_COLOR, STYLE, WIDTH_INCH
from tam_validation.papers.sweep import Sweep
from tam_validation.papers.wu2025_sweeps import (
    BEFORE,
    BEST,
    BOUND,
    CORRECTED,
    FLOOR,
    GROUPS,
    HELD_OUT,
    IN_SAMPLE,
    PUBLISHED,
    RELATIVE_ERROR,
)

_COLORS = {PUBLISHED: BEFORE_COLOR, CORRECTED: MISSING_COLOR, BEST: AFTER_COLOR}
_LINES = {PUBLISHED: "-", CORRECTED: "--", BEST: "-"}
_LOGARITHMIC_FROM = 3
_FEW_DECADES = 30
_SIZE = (WIDTH_INCH, 4.6)


@matplotlib.rc_context(STYLE)
def plot_relative_errors(sweep: Sweep, with_bound: bool) -> Figure:
    """Draw the mean relative errors of each kind of parameters: all curves of the published method, pale, and means.

    Parameters
    ----------
    sweep : Sweep
        With the relative errors of every method.
    with_bound : bool
        Whether the Cramér–Rao bound is drawn too.
    """
    figure = Figure(figsize=_SIZE, layout="constrained")
    for axes, letter, (group, columns) in zip(figure.subplots(2, 2).flat, "abcd", GROUPS.items(), strict=True):
        percent = 100 * sweep.mean(PUBLISHED, RELATIVE_ERROR)[:, columns]
        axes.plot(sweep.points, percent, color=_COLORS[PUBLISHED], alpha=0.25, linewidth=0.6)
        for method, color in _COLORS.items():
            curve = 100 * sweep.mean(method, RELATIVE_ERROR)[:, columns].mean(axis=1)
            axes.plot(sweep.points, curve, _LINES[method], color=color, marker=".", linewidth=1.4, label=method)
        if with_bound:
            curve = 100 * sweep.mean(BOUND, RELATIVE_ERROR)[:, columns].mean(axis=1)
            axes.plot(sweep.points, curve, ":", color=FLOOR_COLOR, label=BOUND)
        _make_logarithmic(axes, "y")
        _finish(axes, sweep, f"({letter}) {group}", "%")
    _add_legend(figure)
    return figure


@matplotlib.rc_context(STYLE)
def plot_residuals(sweep: Sweep) -> Figure:
    """Draw e_B and e_T before and after calibration; after it in sample, held out, and the noise floor."""
    figure = Figure(figsize=_SIZE, layout="constrained")
    before_e_B, after_e_B, before_e_T, after_e_T = figure.subplots(2, 2).flat
    for axes, quantity, unit, letter in ((before_e_B, "e_B", "nT", "a"), (before_e_T, "e_T", "nT/m", "c")):
        curves = to_nanotesla(sweep.mean(BEFORE, f"{quantity} {IN_SAMPLE}"))
        axes.plot(sweep.points, curves, color=FLOOR_COLOR, marker=".", linewidth=1)
        axes.set_ylim(0, 1.15 * curves.max())
        _finish(axes, sweep, f"({letter}) {quantity} before", unit)
    for value, sensor in zip(sweep.mean(BEFORE, f"e_B {IN_SAMPLE}")[-1], "1234", strict=True):
        place = (sweep.points[-1], to_nanotesla(float(value)))
        before_e_B.annotate(sensor, place, (4, 0), textcoords="offset points", va="center")
    for axes, quantity, unit, letter in ((after_e_B, "e_B", "nT", "b"), (after_e_T, "e_T", "nT/m", "d")):
        _draw_after(axes, sweep, quantity)
        _finish(axes, sweep, f"({letter}) {quantity} after", unit)
    _add_legend(figure)
    return figure


def _draw_after(axes: Axes, sweep: Sweep, quantity: str) -> None:
    drawn = []
    for method, color in _COLORS.items():
        if method == CORRECTED and _is_published(sweep):
            continue
        for data, shape, face in ((IN_SAMPLE, ".-", color), (HELD_OUT, "o:", "white")):
            curve = _curve(sweep, method, f"{quantity} {data}")
            label = f"{method}, {data}"
            axes.plot(sweep.points, curve, shape, color=color, ms=4, mfc=face, lw=1.2, label=label)
            drawn.append(curve)
    floor = _curve(sweep, FLOOR, f"{quantity} {IN_SAMPLE}")
    axes.plot(sweep.points, floor, "--", color=FLOOR_COLOR, linewidth=0.8, label=FLOOR)
    if np.max(drawn) > _LOGARITHMIC_FROM * np.min(drawn):
        _make_logarithmic(axes, "y")
    else:
        low, high = np.min([*drawn, floor]), np.max([*drawn, floor])
        margin = max(0.15 * (high - low), 0.02 * high)
        axes.set_ylim(low - margin, high + margin)


def _is_published(sweep: Sweep) -> bool:
    """Return whether the corrected step 1 gives what the published gives, as it does with a constant intensity."""
    quantity = f"e_B {HELD_OUT}"
    return np.allclose(sweep.mean(PUBLISHED, quantity), sweep.mean(CORRECTED, quantity), rtol=1e-3, atol=0)


def _curve(sweep: Sweep, source: str, quantity: str) -> FloatArray:
    return to_nanotesla(sweep.mean(source, quantity).mean(axis=1))


def _finish(axes: Axes, sweep: Sweep, title: str, unit: str) -> None:
    _make_logarithmic(axes, "x")
    axes.set_title(f"{title} ({unit})", loc="left")
    axes.set_xlabel(sweep.plan.symbol + (f" ({sweep.plan.unit})" if sweep.plan.unit else ""))


def _make_logarithmic(axes: Axes, direction: Literal["x", "y"]) -> None:
    """Make an axis logarithmic, with plain numbers at 1, 2 and 5 where it spans few decades, and else at 1."""
    axes.set(**{f"{direction}scale": "log"})
    axis = axes.xaxis if direction == "x" else axes.yaxis
    low, high = axis.get_data_interval()
    axis.set_major_locator(LogLocator(subs=(1, 2, 5) if high < _FEW_DECADES * low else (1,)))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _add_legend(figure: Figure) -> None:
    handles, labels = figure.axes[1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=2, frameon=False, fontsize=8)
