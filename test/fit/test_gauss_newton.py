"""Steps lead to the least χ² over what is free, and end where rounding or, with new weights, a factor says so."""

from contextlib import nullcontext

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.core.normal_equations import Normal
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.maximum_likelihood import Point, free_rows, gauss_newton
from tam_calibration.model.exceptions import Refused

FREE = np.append(free_rows(2), np.full(5, True))


def target_and_information():
    """Return parameters (29,) of two sensors and a gradient, and an information matrix over them."""
    generator = np.random.default_rng(1)
    root = generator.normal(size=(60, 29))
    return np.where(FREE, generator.normal(size=29), 0.0), root.T @ root


def parameters(point):
    """Return the parameters (29,) of a point."""
    rows = np.concatenate([point.matrix, point.bias[..., None]], axis=2)
    return np.append(rows.ravel(), point.gradient)


def steps_to(target, information, kept, robust, first=None):
    """Return the point found and the number of steps where each leaves a part of the way, and scale the first."""
    start, count = Point(np.zeros((2, 3, 3)), np.zeros((2, 3)), np.zeros(5)), 0
    if first is not None:
        size = (1 - kept) * np.sqrt(target @ information @ target)
        target = target * np.sqrt(first) / size

    def linearize(point):
        nonlocal count
        count += 1
        gradient = (1 - kept) * information @ (target - parameters(point))
        own = Normal(information, gradient, 0.0, 0)
        return Linearization(own, Normal.none(29), np.zeros(29))

    point, found = gauss_newton(linearize, start, robust)
    assert_array_equal(found, information)
    return parameters(point) - target, count


def test_one_step_leads_to_the_least_of_a_parabola():
    """Matrices, biases and gradient; what is not free stays as it is. A second step finds nothing to do."""
    target, information = target_and_information()
    left, count = steps_to(target, information, 0.0, robust=False)
    assert_allclose(left, 0, atol=1e-9)
    assert count == 2


@pytest.mark.parametrize(
    ("energy_kept", "robust", "count"),
    [
        (0.2, False, 10),  # 0.2⁹ is the first below 1e-6
        (0.3, False, 5),  # 0.3⁴ is the first below 0.01, from where falls of less than a quarter are rounding
        (0.36, True, 13),  # 0.36¹² is the first below 1e-5, whatever it falls by
    ],
)
def test_steps_end_where_rounding_begins(energy_kept, robust, count):
    """The first promises a fall of one, and each further one that times the square of what a step leaves."""
    target, information = target_and_information()
    assert steps_to(target, information, np.sqrt(energy_kept), robust, first=1.0)[1] == count


@pytest.mark.parametrize(("size", "is_astray"), [(0.99e6, False), (1.01e6, True)])
def test_a_step_of_a_million_goes_astray(size, is_astray):
    """Matrices and biases are of order one: it is said before numbers overflow."""
    target, information = np.zeros(29), np.eye(29)
    target[0] = size
    with pytest.raises(Refused, match=r"goes astray: .* do not fit one") if is_astray else nullcontext():
        steps_to(target, information, 0.0, robust=False)


def test_steps_that_overshoot_do_not_settle():
    """Each by as much as it should have gone: for ever."""
    target, information = target_and_information()
    with pytest.raises(Refused, match="did not settle in 100 steps"):
        steps_to(target, information, -1.0, robust=False)
