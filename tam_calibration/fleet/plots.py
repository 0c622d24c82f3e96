"""The parameters of a platform over its missions, drawn."""

from datetime import UTC, datetime

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tam_calibration.fleet.parameters import Group, Missions
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, FLOOR_COLOR, QUIET_COLOR, STYLE, WIDTH_INCH

_COLORS = (BEFORE_COLOR, AFTER_COLOR, FLOOR_COLOR)
_HEIGHT_INCH = 1.5


@matplotlib.rc_context(STYLE | {"date.converter": "concise"})
def plot_missions(missions: Missions, group: Group) -> Figure:
    """Draw three parameters of each sensor less their means, with standard errors, over time."""
    factor, unit = (1.0, group.unit) if group.unit else (1e6, "ppm")
    values, errors = factor * missions.values[group], factor * missions.standard_errors[group]
    count = values.shape[1]
    figure = Figure(figsize=(WIDTH_INCH, _HEIGHT_INCH * count + 0.4), layout="constrained")
    panels = figure.subplots(count, sharex=True, squeeze=False)[:, 0]
    times = [datetime.fromtimestamp(time, UTC) for time in missions.time_s]
    for sensor, axes in enumerate(panels):
        for axis, color in enumerate(_COLORS):
            if (errors[:, sensor, axis] > 0).any():
                value = values[:, sensor, axis]
                style = {"fmt": ".", "markersize": 5, "elinewidth": 0.9, "color": color, "label": group.names[axis]}
                axes.errorbar(times, value - np.nanmean(value), errors[:, sensor, axis], **style)
        _finish(axes, f"sensor {sensor + 1}")
    figure.supylabel(f"{group.title} less its mean, {unit}")
    return figure


def _finish(axes: Axes, title: str) -> None:
    axes.axhline(0.0, color=QUIET_COLOR, linewidth=0.6)
    if not axes.containers:
        axes.set_title(f"{title}: held fixed", loc="left")
        axes.set_yticks([])
    else:
        axes.set_title(title, loc="left")
        axes.legend(frameon=False, ncols=3, loc="lower right", bbox_to_anchor=(1.0, 0.95), handletextpad=0.1)
