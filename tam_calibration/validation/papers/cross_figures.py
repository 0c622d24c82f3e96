"""The simulated figures of Li 2018a, Li 2018b and Chi 2017 drawn again: intensities, tensors, and where readings lie.

The papers give them as pictures and print their root mean squares only, which the tables compare. Here they are for the
eye: the same set-ups, with other noise, and with Chi's attitudes drawn anew.
"""

from collections.abc import Mapping, Sequence
from itertools import combinations

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.linalg import norm

from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report.style import FLOOR_COLOR, PAGE_WIDTH_INCH, STYLE
from tam_calibration.validation.papers import chi2017, li2018a, li2018b
from tam_calibration.validation.papers.cross import COMPONENTS, SENSORS, SetUp

_PANEL_INCH, _SQUARE_INCH = 1.2, 2.3
_FIRST_TURN = slice(0, 12)
"""The poses of Li 2018b that turn about z."""

Stages = Mapping[str, FloatArray]
"""Fields (N, 4, 3), tesla, by the stage of their calibration."""


def redraw(paper: str) -> dict[str, Figure]:
    """Return the simulated figures of a paper by their captions; of Wu 2025, whose figures are sweeps, none.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    """
    if paper == "li2018a":
        case = li2018a.set_up()
        stages = li2018a.stages(case)
        before = {stage: fields for stage, fields in stages.items() if stage == "before"}
        return {
            "Fig. 4: components in all poses, of the platform in black": _plot_components(case.field_T, before),
            "Fig. 5: intensities of the sensors": _plot_intensities(stages),
            "Fig. 6: components of the tensor": _plot_tensors(case, stages),
        }
    if paper == "li2018b":
        case = li2018b.set_up()
        stages = li2018b.stages(case)
        ends = {stage: stages[stage][_FIRST_TURN] for stage in (li2018b.BEFORE, li2018b.ALIGNED)}
        return {
            "Fig. 4: intensities of the sensors": _plot_intensities(stages),
            "Fig. 5: components of the tensor": _plot_tensors(case, stages),
            "Fig. 6: components over the first turn about z, of the platform in black": _plot_components(
                case.field_T[_FIRST_TURN], ends
            ),
        }
    if paper == "chi2017":
        case = chi2017.set_up()
        stages = chi2017.stages(case)
        return {
            "Fig. 4: intensities of the sensors": _plot_intensities(stages),
            "Fig. 5: components of the tensor": _plot_tensors(case, stages),
        }
    return {}


def _plot_intensities(stages: Stages) -> Figure:
    series = {stage: to_nanotesla(norm(fields, axis=2)) for stage, fields in stages.items()}
    return _plot_series(series, SENSORS, "nT")


def _plot_tensors(case: SetUp, stages: Stages) -> Figure:
    series = {stage: to_nanotesla(case.tensor_T_per_m(fields)) for stage, fields in stages.items()}
    return _plot_series(series, COMPONENTS, "nT/m")


@matplotlib.rc_context(STYLE)
def _plot_series(series: Mapping[str, FloatArray], labels: Sequence[str], unit: str) -> Figure:
    """Draw series (N, M) over the pose, a panel for each stage with a scale of its own."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, _PANEL_INCH * len(series) + 0.5), layout="constrained")
    panels = figure.subplots(len(series), 1, sharex=True)
    for axes, (stage, values) in zip(panels, series.items(), strict=True):
        axes.plot(np.arange(1, len(values) + 1), values, linewidth=0.5, rasterized=True)
        axes.set_title(f"{stage} ({unit})", loc="left")
    panels[-1].set_xlabel("pose")
    figure.legend(panels[0].lines, labels, loc="outside lower center", ncols=len(labels), frameon=False, fontsize=8)
    return figure


@matplotlib.rc_context(STYLE)
def _plot_components(platform_T: FloatArray, stages: Stages) -> Figure:
    """Draw fields in the three planes of the axes, a row for each stage, and the (N, 3) field of the platform."""
    figure = Figure(figsize=(PAGE_WIDTH_INCH, _SQUARE_INCH * len(stages) + 0.5), layout="constrained")
    grid = figure.subplots(len(stages), 3, squeeze=False)
    largest = 1e-3 * to_nanotesla(max(float(np.abs(fields).max()) for fields in (platform_T, *stages.values())))
    for row, (stage, fields) in zip(grid, stages.items(), strict=True):
        for axes, (first, second) in zip(row, combinations(range(3), 2), strict=True):
            for sensor in range(len(SENSORS)):
                own = 1e-3 * to_nanotesla(fields[:, sensor])
                axes.plot(own[:, first], own[:, second], ".", ms=2, rasterized=True)
            true = 1e-3 * to_nanotesla(platform_T)
            axes.plot(true[:, first], true[:, second], ".", ms=2, color=FLOOR_COLOR, rasterized=True)
            axes.set_title(f"{stage}, {'xyz'[first]} and {'xyz'[second]} (µT)", loc="left")
            axes.set(xlim=(-largest, largest), ylim=(-largest, largest), aspect="equal")
    labels = [*SENSORS, "platform"]
    figure.legend(
        grid[0, 0].lines,
        labels,
        loc="outside lower center",
        ncols=len(labels),
        frameon=False,
        fontsize=8,
        markerscale=4,
    )
    return figure
