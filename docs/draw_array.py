"""Draw ``docs/images/cross_array.png``: the cross array, its frame, and what it measures.

Run ``python docs/draw_array.py``.
"""

from pathlib import Path

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tam_calibration.model.array import Array
from tam_calibration.report.page import STYLE

TARGET = Path(__file__).parent / "images" / "cross_array.png"
_BASELINE_M, _AXIS_M = 0.5, 0.09
"""Of the cross that is the default, and the length of an arrow."""


@matplotlib.rc_context(STYLE)
def main() -> None:
    """Draw the array from above."""
    figure = Figure(figsize=(4.6, 4.2), layout="constrained")
    axes = figure.subplots()
    for number, (x, y, _) in enumerate(Array.cross(_BASELINE_M).positions_m, start=1):
        axes.plot([0, -y], [0, x], color="0.6", linewidth=3, zorder=0)
        _sensor(axes, -y, x, f"sensor {number}")
    axes.plot(0, 0, "s", color="0.2", markersize=11)
    axes.text(0.03, 0.06, "centre: field vector,\ngradient tensor,\nscalar magnetometer", fontsize=8)
    axes.annotate("", (0.25, -0.33), (-0.25, -0.33), arrowprops={"arrowstyle": "<->", "color": "0.4"})
    axes.text(0, -0.37, f"baseline {_BASELINE_M:g} m", ha="center", va="top", fontsize=8, color="0.4")
    axes.set(xlim=(-0.45, 0.45), ylim=(-0.42, 0.42), aspect="equal")
    axes.set_axis_off()
    figure.savefig(TARGET, dpi=150)


def _sensor(axes: Axes, right: float, up: float, name: str) -> None:
    """Draw a tri-axial magnetometer from above: x forward (up), y left, z towards the reader."""
    for step, axis in (((0, _AXIS_M), "x"), ((-_AXIS_M, 0), "y")):
        end = right + step[0], up + step[1]
        axes.annotate("", end, (right, up), arrowprops={"arrowstyle": "->", "color": "C0", "linewidth": 1.6})
        axes.text(right + 1.25 * step[0], up + 1.25 * step[1], axis, color="C0", fontsize=9, ha="center", va="center")
    axes.plot(right, up, "o", color="C0", markersize=9, fillstyle="none")
    axes.plot(right, up, ".", color="C0")
    axes.text(right + 0.02, up - 0.035, name, fontsize=9, va="top")


if __name__ == "__main__":
    main()
