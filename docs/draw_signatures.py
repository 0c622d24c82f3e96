"""Draw ``docs/images/signatures.png``: what each law with each course looks like in the residual of one axis.

Run ``python docs/draw_signatures.py`` after the table of causes was changed.
"""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from tam_calibration.gap.laws.law import CAUSES
from tam_calibration.model.units import FloatArray
from tam_calibration.report.page import STYLE

TARGET = Path(__file__).parent / "images" / "signatures.png"

LAWS = ("offset", "gain", "rate", "own_field", "attitude", "noise", "samples")
COURSES = ("constant", "motion", "step", "episodes", "slow", "channel", "tone", "random")

GENERATOR = np.random.default_rng(1)
TIME_S = np.linspace(0, 60, 600)
FIELD = np.sin(0.9 * TIME_S) * np.cos(0.35 * TIME_S)
"""Field along one axis while the array tumbles, over the total intensity."""

TILT = np.cos(0.55 * TIME_S)
"""Vertical part of that axis."""

PATTERNS = {
    "offset": np.ones_like(TIME_S),
    "gain": FIELD,
    "rate": np.gradient(FIELD, TIME_S),
    "own_field": 2 * FIELD**3 - FIELD,
    "attitude": np.tanh(6 * (TILT + 0.3)),
    "noise": GENERATOR.normal(size=600),
    "samples": np.where(GENERATOR.random(600) < 0.03, 3 * GENERATOR.choice([-1, 1], 600), 0),
}
"""What each law does to the reading, for a disturbance of size one."""

SIZES = {
    "constant": np.ones_like(TIME_S),
    "motion": TILT**2,
    "step": np.where(TIME_S < 35, -0.5, 1.0),
    "episodes": np.where((TIME_S // 9) % 2 == 1, 1.0, 0.0),
    "slow": np.sin(0.06 * TIME_S + 0.5) + 0.4 * np.sin(0.17 * TIME_S),
    "channel": 1 - 2 * np.exp(-TIME_S / 15),  # a temperature that settles
    "tone": np.sin(2 * np.pi * 0.4 * TIME_S),
    "random": GENERATOR.normal(size=600),
}
"""Size of the disturbance over time, for each course."""


def residual(law: str, course: str) -> FloatArray:
    """Return the residual (N,) in units of the disturbance."""
    own = course == "motion" and law in ("own_field", "attitude")
    size = np.ones_like(TIME_S) if own else SIZES[course]
    return np.asarray(PATTERNS[law] * size + 0.12 * GENERATOR.normal(size=600))


@matplotlib.rc_context(STYLE)
def main() -> None:
    """Draw a row for each law and a column for each course, where a cause has both."""
    known = {(law, course) for cause in CAUSES for law in cause.law for course in cause.course}
    figure = Figure(figsize=(11, 7), layout="constrained")
    grid = figure.subplots(len(LAWS), len(COURSES), sharex=True)
    for row, law in zip(grid, LAWS, strict=True):
        row[0].set_ylabel(law.replace("_", " "))
        for axes, course in zip(row, COURSES, strict=True):
            axes.set_xticks([])
            axes.set_yticks([])
            axes.set_ylim(-3.2, 3.2)
            if (law, course) in known:
                axes.plot(TIME_S, residual(law, course), linewidth=0.6)
            else:
                axes.set_facecolor("0.93")
    for axes, course in zip(grid[0], COURSES, strict=True):
        axes.set_title(course)
    figure.supxlabel("time, one minute of a tumble")
    figure.supylabel("residual of one axis")
    TARGET.parent.mkdir(exist_ok=True)
    figure.savefig(TARGET, dpi=110)


if __name__ == "__main__":
    main()
