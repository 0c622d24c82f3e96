"""Times at which a law comes and goes."""

import numpy as np
import pytest

from tam_calibration.gap.laws.patterns import in_sensor
from tam_calibration.gap.laws.states import change_times
from tam_calibration.gap.laws.whitened import residual_of


def offset_of(residual, sensor, axis):
    """Return the pattern of an offset of one axis."""
    of_all = next(one for one in in_sensor(residual, sensor) if one.law == "offset")
    return next(part for part, _ in of_all.parts() if part.axes == (axis,))


@pytest.mark.parametrize("edges", [(22.02,), (12.03, 31.01), (3.02, 5.53, 14.01, 20.02, 29.03, 33.02)])
def test_changes_are_found_to_the_sample(run, edges):
    """A jump for good, one on and off, and several episodes."""
    clean = run(samples=900)
    time_s = clean.recording.time_s
    on = np.searchsorted(edges, time_s, side="right") % 2
    residual = residual_of(clean.with_row(7, 6e-9 * on).model())
    found = change_times(residual, offset_of(residual, 3, "y"), residual)
    near = [one for one in found if len(one) == len(edges)]
    step_s = float(np.median(np.diff(time_s)))
    assert min(np.abs(np.subtract(one, edges)).max() for one in near) < 1.5 * step_s


def test_the_rarer_state_is_the_one_that_comes_and_goes(run):
    """What is on nearly all the time is off in windows."""
    clean = run(samples=900)
    time_s = clean.recording.time_s
    off = ((time_s > 8) & (time_s < 10)) | ((time_s > 30) & (time_s < 31))
    residual = residual_of(clean.with_row(7, 6e-9 * ~off).model())
    found = change_times(residual, offset_of(residual, 3, "y"), residual)
    assert any(np.abs(np.subtract(one, (8, 10, 30, 31))).max() < 0.1 for one in found if len(one) == 4)
