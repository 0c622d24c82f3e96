"""The last stretch of a line as it is recorded: bounded, with positions between those that are known."""

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.localization.line_data import SlidingLine

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


UNKNOWN = np.full(3, np.nan)


def kept(seconds, span_s=10.0, rates=UNKNOWN):
    """Return a line of so many seconds, ten samples and one position each second."""
    line = SlidingLine(span_s)
    for tick in range(10 * seconds):
        if tick % 10 == 0:
            line.push_position(tick / 10, np.array([1.5 * tick / 10, 0.0, -3.0]))
        line.push_sample(tick / 10, np.full((4, 3), 1e-6 * tick), LEVEL, rates)
    return line


def test_the_last_seconds_are_kept_with_interpolated_positions():
    """Of a minute the last ten seconds; a sample after the last position has none."""
    recording = kept(60).recording()
    assert_allclose(recording.time_s[[0, -1]], [49.9, 59.9], atol=0.11)
    known = np.isfinite(recording.position_m).all(axis=1)
    assert_allclose(recording.position_m[known, 0], 1.5 * recording.time_s[known])
    assert (known == (recording.time_s <= 59.0)).all()


def test_a_clock_that_steps_back_starts_a_new_line():
    """What was before is forgotten; without positions there is no line."""
    line = kept(20)
    line.push_sample(1.0, np.zeros((4, 3)), LEVEL, UNKNOWN)
    assert line.recording() is None
    for time_s in (2.0, 3.0):
        line.push_position(time_s, np.zeros(3))
    assert len(line.recording().time_s) == 1


def test_angular_velocities_are_kept_where_there_are_any():
    """A line without a gyroscope has none, rather than unknown ones."""
    assert kept(20).recording().angular_velocity_rad_s is None
    rates = kept(20, rates=np.array([0.0, 0.1, 0.2])).recording().angular_velocity_rad_s
    assert_allclose(rates, np.tile([0.0, 0.1, 0.2], (len(rates), 1)))
