"""The drift is drawn for each sensor, what was held fixed is not."""

import numpy as np

from tam_calibration.fleet.missions import GROUPS, Missions
from tam_calibration.fleet.summary import plot_missions
from tam_calibration.report.page import embed


def missions(count):
    """Return missions of four sensors whose misalignment of sensor 1 is fixed."""
    rng = np.random.default_rng(3)
    values = {group: rng.normal(size=(count, 4, 3)) for group in GROUPS}
    errors = {group: np.ones((count, 4, 3)) for group in GROUPS}
    errors[GROUPS[3]][:, 0] = 0
    return Missions("auv", 1.7e9 + 86400.0 * np.arange(count), values, errors)


def test_each_sensor_has_a_panel_with_three_parameters():
    """Less their means; the fixed ones of sensor 1 are left out."""
    figure = plot_missions(missions(5), GROUPS[3])
    drawn = [len(axes.containers) for axes in figure.axes]
    assert drawn == [0, 3, 3, 3]
    for axes in figure.axes[1:]:
        for bars in axes.containers:
            assert abs(np.mean(bars.lines[0].get_ydata())) < 1e-12


def test_a_figure_is_the_same_bytes_every_time():
    """So that a batch that is resumed gives the same page; one mission is drawn too."""
    for count in (1, 4):
        first, second = (embed(plot_missions(missions(count), GROUPS[2]), "bias").source for _ in range(2))
        assert first == second
