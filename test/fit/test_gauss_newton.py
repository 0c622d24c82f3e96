"""Gauss-Newton steps that lead to nowhere end in a sentence."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit.information import descend
from tam_calibration.model.exceptions import Refused


def steps_to(target, information, part):
    """Return where steps lead that go so large a part of the way, from zero, and what was kept."""

    def normal_at(point):
        return information, part * information @ (target - point), point

    return descend(normal_at, np.add, np.zeros(24))


def test_a_whole_step_is_the_last_but_one():
    """A parabola takes one step; what is kept is from the point of the second."""
    root = np.random.default_rng(1).normal(size=(60, 24))
    end, kept = steps_to(np.ones(24), root.T @ root, 1.0)
    assert_allclose([end, kept], 1, rtol=1e-12)


def test_steps_that_overshoot_do_not_settle():
    """Each by as much as it should have gone: for ever."""
    root = np.random.default_rng(1).normal(size=(60, 24))
    with pytest.raises(Refused, match="did not settle in 100 steps"):
        steps_to(np.ones(24), root.T @ root, 2.0)
