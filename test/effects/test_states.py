"""States that begin and end at times."""

from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.effects.states import BiasJump, ScaleStep, in_windows, is_on, windows_at


@pytest.mark.parametrize("effect", [BiasJump(), ScaleStep()], ids=lambda effect: effect.name)
def test_steps_at_few_times(effect):
    """A step begins at each time, and may end at a later one; what changes four times is no step."""
    assert effect.shapes_at([1.0, 2.0], None) == [{"time_s": 1.0}, {"time_s": 2.0}, {"time_s": 1.0, "end_s": 2.0}]
    assert len(effect.shapes_at([1.0, 2.0, 3.0], None)) == 6
    assert effect.shapes_at([1.0, 2.0, 3.0, 4.0], None) == []


def test_a_step_is_on_between_its_times():
    """From its time on, before its end."""
    time_s = np.arange(5.0)
    assert is_on(time_s, {"time_s": 1.0}).tolist() == [False, True, True, True, True]
    assert is_on(time_s, {"time_s": 1.0, "end_s": 3.0}).tolist() == [False, True, True, False, False]


@pytest.mark.parametrize("times_s", [[1.5], [1.5, 3.0], [0.5, 1.5, 3.5]])
def test_windows_begin_and_end_in_turn(times_s):
    """The last may have no end."""
    covariates = SimpleNamespace(time_s=np.arange(5.0))
    expected = [sum(one <= time for one in times_s) % 2 == 1 for time in range(5)]
    assert in_windows(covariates, windows_at(times_s)).tolist() == expected


def test_more_than_three_hundred_windows_are_none():
    """Their limits have no names."""
    assert len(windows_at(range(600))) == 600 and windows_at(range(601)) == {}
