"""Gauss-Newton steps that lead astray, or to nowhere, end in a sentence."""

from contextlib import nullcontext

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.core.least_squares import Normal
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.maximum_likelihood import Point, free_rows, gauss_newton
from tam_calibration.model.exceptions import Refused


def step_to(target, information, part):
    """Go to parameters (24,) of two sensors by steps that go so large a part of the way."""

    def linearize(point):
        rows = np.concatenate([point.matrix, point.bias[..., None]], axis=2)
        left = target - rows.ravel()
        return Linearization(Normal(information, part * information @ left, 0.0, 0), Normal.none(24), np.zeros(24))

    _, found = gauss_newton(linearize, Point(np.zeros((2, 3, 3)), np.zeros((2, 3))), False)
    assert_array_equal(found, information)


@pytest.mark.parametrize(("size", "is_astray"), [(0.99e6, False), (1.01e6, True)])
def test_a_step_of_a_million_goes_astray(size, is_astray):
    """Matrices and biases are of order one: it is said before numbers overflow."""
    with pytest.raises(Refused, match=r"goes astray: .* do not fit one") if is_astray else nullcontext():
        step_to(size * np.eye(24)[0], np.eye(24), 1.0)


def test_steps_that_overshoot_do_not_settle():
    """Each by as much as it should have gone: for ever."""
    root = np.random.default_rng(1).normal(size=(60, 24))
    with pytest.raises(Refused, match="did not settle in 100 steps"):
        step_to(free_rows(2).astype(float), root.T @ root, 2.0)
