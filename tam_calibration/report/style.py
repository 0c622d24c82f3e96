"""The look that the figures of all reports share."""

from typing import Any

BEFORE_COLOR = "#c0701a"
AFTER_COLOR = "#1f5f99"
FLOOR_COLOR = "#3c4650"
MISSING_COLOR = "#f0a35e"
QUIET_COLOR = "#5b6773"
COLORS = (BEFORE_COLOR, AFTER_COLOR, FLOOR_COLOR, QUIET_COLOR, MISSING_COLOR)
"""Of lines in one figure, in order."""

WIDTH_INCH = 4.7
"""Of a plain figure."""

PAGE_WIDTH_INCH = 7.4
"""Of a figure that takes the complete width of a page."""

STYLE: dict[Any, Any] = {
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "axes.titlesize": 9,
    "figure.labelsize": 9,
    "axes.linewidth": 0.6,
    "axes.edgecolor": QUIET_COLOR,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.formatter.useoffset": False,
    "xtick.color": FLOOR_COLOR,
    "ytick.color": FLOOR_COLOR,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "figure.constrained_layout.wspace": 0.08,
}
"""Settings of matplotlib; the font is the one that it brings along."""
