"""Damped steps, whose solutions are those of scipy, and roots of matrices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_calibration.core.least_squares import root_of, scaled, solve_damped

TIMES = np.linspace(0, 2, 12)


def decay(unknowns, _):
    """Return amplitudes and rates (M, 2) as decays (M, 12), with derivatives."""
    amplitude, rate = unknowns[:, :1], unknowns[:, 1:]
    fall = np.exp(-rate * TIMES)
    return amplitude * fall, np.stack([fall, -amplitude * TIMES * fall], axis=2)


def is_small(unknowns, step):
    """Return which steps change nothing that counts."""
    return np.linalg.norm(step, axis=1) < 1e-11 * np.linalg.norm(unknowns, axis=1)


@pytest.mark.parametrize("seed", range(4))
def test_solutions_are_those_of_scipy(seed):
    """Of many problems side by side, with χ² and covariance."""
    rng = np.random.default_rng(seed)
    truth = np.column_stack([rng.uniform(1, 5, 6), rng.uniform(0.2, 2, 6)])
    data = decay(truth, None)[0] + 0.05 * rng.normal(size=(6, 12))
    found = solve_damped(decay, data, truth * rng.uniform(0.7, 1.3, truth.shape), is_small)
    assert found.is_found.all()
    for values, own, start, unknowns, chi_square in zip(
        data, found.covariance, truth, found.unknowns, found.chi_square, strict=True
    ):
        expected = least_squares(lambda x, y=values: decay(x[None], None)[0][0] - y, start, xtol=1e-12, ftol=1e-12)
        assert_allclose(unknowns, expected.x, rtol=1e-5)
        assert chi_square == pytest.approx(2 * expected.cost, rel=1e-8)
        assert_allclose(own, np.linalg.inv(expected.jac.T @ expected.jac), rtol=1e-3)


def test_a_problem_does_not_depend_on_its_neighbours():
    """Alone it takes the same steps, to the last bit."""
    rng = np.random.default_rng(4)
    data = decay(np.array([[3.0, 1.0], [1.0, 0.3], [2.0, 2.0]]), None)[0] + 0.1 * rng.normal(size=(3, 12))
    start = np.ones((3, 2))
    together = solve_damped(decay, data, start, is_small)
    for number in range(3):
        alone = solve_damped(decay, data[[number]], start[[number]], is_small)
        assert_allclose(alone.unknowns[0], together.unknowns[number], rtol=1e-13)


def test_unknowns_that_the_data_do_not_tell_are_not_found():
    """Two that act alike have no covariance."""

    def alike(unknowns, _):
        return unknowns.sum(axis=1, keepdims=True) * TIMES, np.repeat(TIMES[None, :, None], 2, axis=2)

    found = solve_damped(alike, 3 * TIMES[None], np.ones((1, 2)), is_small)
    assert not found.is_found[0] and np.isnan(found.covariance).all()


def test_no_problem_has_no_solution():
    """Nothing is asked, nothing is answered."""
    found = solve_damped(decay, np.zeros((0, 12)), np.zeros((0, 2)), is_small)
    assert found.unknowns.shape == (0, 2) and found.is_found.shape == (0,)


def test_scaled_matrices_have_a_diagonal_of_ones():
    """And the matrix comes back with the scales; a diagonal that is not positive is left."""
    matrix = np.array([[4.0, 2.0], [2.0, 9.0]])
    unit, scale = scaled(matrix)
    assert_allclose(np.diag(unit), 1)
    assert_allclose(unit * np.outer(scale, scale), matrix)
    assert_allclose(scaled(np.array([[0.0, 0.0], [0.0, 4.0]]))[1], [1, 2])


def test_unknowns_that_act_alike_are_not_found_and_break_no_neighbour():
    """One problem of two in which a and b count only as a + b: the other is solved as if it were alone."""

    def predict(unknowns, at):
        first, second = unknowns[:, :1], unknowns[:, 1:]
        is_alike = (at == 0)[:, None]
        data = first + np.where(is_alike, 1.0, TIMES) * second + 1e-3 * first**2
        by_second = np.broadcast_to(np.where(is_alike, 1.0, TIMES), data.shape)
        alike = is_alike[..., None] * np.ones((1, len(TIMES), 2))
        slopes = np.stack([np.broadcast_to(1 + 2e-3 * first, data.shape), by_second], axis=2)
        return np.where(is_alike, first + second, data), np.where(alike > 0, 1.0, slopes)

    data = np.stack([np.full(len(TIMES), 3.0), 1 + 2 * TIMES + 1e-3])
    solution = solve_damped(
        predict, data, np.array([[0.5, 0.25], [0.5, 0.5]]), lambda _, step: np.zeros(len(step), bool)
    )
    assert_allclose(solution.unknowns[1], [1, 2], atol=1e-9)
    assert np.isnan(solution.covariance[0]).all() and not solution.is_found[0]


def test_there_may_be_more_problems_than_data():
    """Each is solved to its own truth."""
    truth = np.random.default_rng(5).uniform([1, 0.2], [5, 2], (40, 2))
    found = solve_damped(decay, decay(truth, None)[0], 1.2 * truth, is_small)
    assert found.is_found.all()
    assert_allclose(found.unknowns, truth, rtol=1e-9)


@pytest.mark.parametrize("unit", [1e-15, 1.0, 1e15])
def test_a_step_that_leads_astray_is_taken_back_in_any_unit(unit):
    """Steps of Gauss and Newton to the zero of an arc tangent diverge from 2."""

    def bent(unknowns, _):
        return unit * (1 + np.arctan(unknowns)), unit / (1 + unknowns[..., None] ** 2)

    found = solve_damped(bent, np.full((1, 1), unit), np.full((1, 1), 2.0), lambda _, step: np.abs(step[:, 0]) < 1e-12)
    assert found.is_found[0] and found.unknowns[0, 0] == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_exact_has_no_part_in_the_root_of_a_covariance(seed):
    """However the others are correlated; and the root times its transpose is the covariance."""
    mixing = np.random.default_rng(seed).normal(size=(8, 5)) * np.geomspace(1e-9, 1, 8)[:, None]
    mixing[[1, 4]] = 0.0
    root = root_of(mixing @ mixing.T)
    assert (root[[1, 4]] == 0).all()
    assert_allclose(root @ root.T, mixing @ mixing.T, rtol=1e-6, atol=1e-24)
