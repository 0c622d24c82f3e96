"""Many sources side by side as problems of least squares: derivatives, starts, and that none depends on another."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.localization.source_problem import Problem, solve
from tam_calibration.sources.dipole import dipole_field

GENERATOR = np.random.default_rng(6)
POINTS = GENERATOR.normal(size=(2, 4, 3)) * 0.3
PLACES = np.array([[2.0, 1.0, -1.5], [-1.0, 2.5, 0.5], [0.5, -2.0, 2.0]])
MOMENTS = np.array([[10.0, -20.0, 30.0], [5.0, 15.0, -10.0], [-20.0, 4.0, 8.0]])
FURTHER = np.array([[0.3], [-0.2], [0.1]])
TRUTH = np.concatenate([PLACES, MOMENTS, FURTHER], axis=1)
COMMON = 1e7 * GENERATOR.normal(size=(2, 10, 12))
OWN = COMMON * np.array([1.0, 2.0, 0.5])[:, None, None, None]
LINEAR = GENERATOR.normal(size=(2, 10, 1))


@pytest.mark.parametrize("weights", [COMMON, OWN], ids=["common", "own"])
def test_data_are_the_weighted_fields_and_what_is_linear(weights):
    """Of two poses with four sensors, for three problems at once."""
    data, _ = Problem(dipole_field, POINTS, weights, LINEAR).predict(TRUTH)
    assert data.shape == (3, 20)
    for at, (place, moment, further) in enumerate(zip(PLACES, MOMENTS, FURTHER, strict=True)):
        own = weights if weights.ndim == 3 else weights[at]
        for pose in range(2):
            field = dipole_field(POINTS[pose] - place, np.tile(moment, (4, 1)))[0].ravel()
            expected = own[pose] @ field + LINEAR[pose] @ further
            assert_allclose(data[at, 10 * pose : 10 * pose + 10], expected, rtol=1e-12)


def test_derivatives_are_those_of_differences():
    """By place, moment and what is linear."""
    problem = Problem(dipole_field, POINTS, OWN, LINEAR)
    derivative = problem.predict(TRUTH)[1]
    assert derivative.shape == (3, 20, 7)
    for column in range(7):
        step = np.zeros(7)
        step[column] = 1e-5
        expected = (problem.predict(TRUTH + step)[0] - problem.predict(TRUTH - step)[0]) / 2e-5
        assert_allclose(derivative[..., column], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_a_start_at_the_place_has_the_moment():
    """All but the place is linear, and found at once."""
    problem = Problem(dipole_field, POINTS, OWN, LINEAR)
    assert_allclose(problem.start(problem.predict(TRUTH)[0], PLACES), TRUTH, rtol=1e-9)


@pytest.mark.parametrize("weights", [COMMON, OWN], ids=["common", "own"])
def test_each_problem_is_solved_as_if_alone(weights):
    """From places a few decimetres off, whatever its neighbours do; one that begins at the truth stays."""
    problem = Problem(dipole_field, POINTS, weights, LINEAR)
    data = problem.predict(TRUTH)[0]
    start = problem.start(data, PLACES + np.array([[0.3, -0.2, 0.1], [0.0, 0.0, 0.0], [-0.1, 0.2, 0.2]]))
    solution = solve(problem, data, start)
    assert solution.is_found.all()
    assert_allclose(solution.unknowns, TRUTH, rtol=1e-9)
    for at in range(3):
        own = weights if weights.ndim == 3 else weights[at : at + 1]
        alone = solve(Problem(dipole_field, POINTS, own, LINEAR), data[at : at + 1], start[at : at + 1])
        assert_allclose(alone.unknowns[0], solution.unknowns[at], rtol=1e-12)
