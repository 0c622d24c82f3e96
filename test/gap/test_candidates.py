"""Recordings that could be made next are such that people can make them."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.gap.candidates import candidates


@pytest.mark.parametrize(("step_s", "shortest_s"), [(0.05, 3.5), (1.0, 16.0)])
def test_hands_turn_an_array_within_some_seconds(run, step_s, shortest_s):
    """A fast turn takes about five, as a pose is held, but more where sixteen samples of it last longer."""
    now = replace(run(60).channels().covariates, time_s=step_s * np.arange(60))
    fast = {one.path: one.turn_s for one in candidates(now, ())}
    assert shortest_s <= fast["back and forth"] == fast["swings"] <= max(7.0, shortest_s)
    assert 3.5 <= fast["poses"] <= 7.0
