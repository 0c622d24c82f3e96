"""The causes of a gap: their probabilities, and what each takes away."""

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.gap.result import Gap
from tam_calibration.report.gap_rows import percent
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, PAGE_WIDTH_INCH, QUIET_COLOR, STYLE

_SHOWN = 8
"""Likeliest causes that are drawn: those below share a few per mille."""

_TOLD = 1e-3
"""Probability that reads as zero in a drawing."""


@matplotlib.rc_context(STYLE)
def plot_evidence(gap: Gap) -> Figure:
    """Draw the probabilities of what can be the cause, the likeliest on top, supported ones in full colour."""
    supported = {cause.fitted.effect for cause in gap.causes}
    ranked = sorted(gap.probabilities.items(), key=lambda each: -each[1])
    shown = [each for each in ranked[:_SHOWN] if each[1] >= _TOLD or each[0] in supported] or ranked[:1]
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
    """Draw how the energy of the gap falls from the whole to what is left, one step a cause."""
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
