"""The field of a sample is eliminated as by least squares, and what is left is white and free of it.

Damped steps, whose solutions are those of scipy, and roots of matrices.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_calibration.core.least_squares import (
    Elimination,
    Normal,
    gram,
    ridged,
    root_of,
    scaled,
    solve_damped,
    whitening,
)
from tam_calibration.model.sensor_errors import SensorErrors


@pytest.mark.parametrize("shape", [(1, 5), (13, 1), (11, 20_000), (48, 1001)])
def test_it_is_the_sum_of_the_outer_products(shape):
    """Whatever the size, the sum is that of one product, and as symmetric."""
    columns = np.random.default_rng(2).normal(size=shape)
    found = gram(columns)
    assert_allclose(found, columns @ columns.T, rtol=1e-10, atol=1e-10)
    assert_allclose(found, found.T, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_a_ridge_is_a_billionth_of_the_mean_information_in_each_direction(unit):
    """In any unit, and of each of several matrices by itself."""
    information = unit * np.array([np.diag([1.0, 2.0, 6.0]), np.diag([10.0, 20.0, 60.0])])
    means = unit * np.array([3.0, 30.0])
    assert_allclose(ridged(information) - information, 1e-9 * means[:, None, None] * np.eye(3), rtol=1e-5)


def test_a_matrix_of_zeros_gets_a_ridge_of_a_billionth():
    """So that it has an inverse, and a score of zero no value."""
    assert_allclose(ridged(np.zeros((2, 3, 3))), np.broadcast_to(1e-9 * np.eye(3), (2, 3, 3)))


def test_equations_of_parts_add_up_to_those_of_the_whole():
    """And those of the whole less a part are those of the rest."""
    generator = np.random.default_rng(3)
    columns, channels = generator.normal(size=(4, 30)), generator.normal(size=30)

    def of(part):
        x, y = columns[:, part], channels[part]
        return Normal(x @ x.T, x @ y, float(y @ y), float(y.size))

    first, last, whole = of(slice(0, 11)), of(slice(11, 30)), of(slice(0, 30))
    for found, expected in ((first + last, whole), (whole - first, last)):
        assert_allclose(found.information, expected.information, atol=1e-12)
        assert_allclose(found.score, expected.score, atol=1e-12)
        assert (found.energy, found.count) == (pytest.approx(expected.energy), expected.count)


def draw(seed, rows):
    """Return responses (rows, 3) and weights (rows,) at random."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(rows, 3)), np.exp(rng.normal(size=rows))


cases = pytest.mark.parametrize(("seed", "rows"), [(1, 3), (2, 4), (3, 9), (4, 15)])


@cases
def test_the_field_is_that_of_weighted_least_squares(seed, rows):
    """As numpy solves it, with the covariance of its estimate."""
    response, weight = draw(seed, rows)
    readings = np.random.default_rng(seed + 1).normal(size=rows)
    found = Elimination.of(response, weight)
    expected = np.linalg.lstsq(weight[:, None] * response, weight * readings, rcond=None)[0]
    size = np.linalg.cond(weight[:, None] * response) ** 2
    assert_allclose(found.unmixing @ readings, expected, atol=1e-13 * size * np.abs(expected).max(), rtol=1e-9)
    noise = np.diag(weight**-2.0)
    assert_allclose(found.unmixing @ noise @ found.unmixing.T, found.covariance, rtol=1e-6, atol=1e-12 * size)


@cases
def test_the_differential_channels_are_white_and_see_no_field(seed, rows):
    """Of unit variance, without correlation among themselves or with the field, and one fewer for each component."""
    response, weight = draw(seed, rows)
    found, noise = Elimination.of(response, weight), np.diag(weight**-2.0)
    assert found.directions.shape == (rows, rows - 3)
    assert_allclose(found.directions.T @ noise @ found.directions, np.eye(rows - 3), atol=1e-12)
    assert_allclose(found.directions.T @ response, 0, atol=1e-12 * weight.max() * np.abs(response).max() * rows)
    assert_allclose(found.unmixing @ noise @ found.directions, 0, atol=1e-10 * np.linalg.norm(found.unmixing))


@cases
def test_the_complement_is_the_precision_without_what_the_field_explains(seed, rows):
    """W² - W² A (Aᵀ W² A)⁻¹ Aᵀ W²: so the energies of both parts add up to that of the readings."""
    response, weight = draw(seed, rows)
    found, precision = Elimination.of(response, weight), np.diag(weight**2)
    of_field = precision @ response @ np.linalg.inv(response.T @ precision @ response) @ response.T @ precision
    size = np.linalg.cond(weight[:, None] * response) ** 2
    assert_allclose(found.complement, precision - of_field, atol=1e-14 * size * weight.max() ** 2)


def test_a_row_without_weight_is_as_if_it_were_not_there():
    """As an axis that is not trusted."""
    response, weight = draw(1, 12)
    weight[5] = 0
    rest = np.arange(12) != 5
    found, expected = Elimination.of(response, weight), Elimination.of(response[rest], weight[rest])
    assert_allclose(found.unmixing[:, rest], expected.unmixing, rtol=1e-10)
    assert not found.unmixing[:, 5].any() and not found.directions[5].any()
    assert_allclose(found.complement[np.ix_(rest, rest)], expected.complement, atol=1e-12)


def test_the_variance_along_a_direction_is_that_of_the_length():
    """By simulation: the length of a large field varies as the field along it."""
    rng = np.random.default_rng(3)
    errors = SensorErrors.none(4)
    noise_T = np.array([1.0, 2.0, 0.5, 1.5]) * 1e-9
    found = Elimination.of_sensors(errors, noise_T)
    field_T = np.array([30e-6, -20e-6, 35e-6])
    readings = np.tile(field_T, 4) + np.repeat(noise_T, 3) * rng.normal(size=(20_000, 12))
    length = np.linalg.norm(readings @ found.unmixing.T, axis=1)
    direction = field_T / np.linalg.norm(field_T)
    assert length.var() == pytest.approx(found.variance_along(direction[:, None])[0], rel=0.03)


def test_with_a_known_field_each_row_is_a_channel():
    """Nothing is eliminated: the channels are the rows in units of their noise."""
    found = Elimination.of_known_field(np.array([1.0, 2.0, 5.0, 3.0]))
    assert_allclose(found.directions, np.diag([1.0, 2.0, 5.0, 3.0]))
    assert found.unmixing.shape == (3, 4) and not found.unmixing.any()
    assert found.covariance.shape == (3, 3) and not found.covariance.any()


def test_sensors_count_by_their_response_and_their_noise():
    """Each axis of a sensor responds by its row of D Λ, and has the noise of its sensor."""
    errors, noise_T = SensorErrors.none(4), np.array([1e-9, 2e-9, 5e-9, 4e-9])
    errors = replace(errors, scale_factor=errors.scale_factor * np.arange(1, 13).reshape(4, 3))
    found = Elimination.of_sensors(errors, noise_T)
    weight = np.repeat(noise_T, 3) ** -2.0
    expected = [1 / np.sum(weight[axis::3] * np.arange(1, 13)[axis::3] ** 2) for axis in range(3)]
    assert_allclose(found.covariance, np.diag(expected), rtol=1e-9, atol=1e-9 * max(expected))
    assert_allclose(found.variance_along(np.eye(3)), expected, rtol=1e-9)


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


def test_whitening_knows_no_units():
    """Columns in other units give the same directions in other units; an open direction stays open."""
    matrix = np.random.default_rng(1).normal(size=(30, 4))
    matrix[:, 3] = matrix[:, 0] + matrix[:, 1]
    information, unit = matrix.T @ matrix, np.array([1e-9, 1.0, 1e6, 1e-3])
    white, other = whitening(information, 1e-9), whitening(information * np.outer(unit, unit), 1e-9)
    assert white.shape == other.shape == (4, 3)
    assert_allclose(white.T @ information @ white, np.eye(3), atol=1e-9)
    fitted, again = (columns @ columns.T for columns in (matrix @ white, (matrix * unit) @ other))
    assert_allclose(fitted @ fitted, fitted, atol=1e-9)
    assert_allclose(again, fitted, atol=1e-9)


def test_a_column_without_information_is_in_no_white_direction():
    """A feature that is zero everywhere divides by nothing, and gets a coefficient of zero."""
    matrix = np.random.default_rng(1).normal(size=(40, 13))
    matrix[:, 6] = 0
    white, others = whitening(matrix.T @ matrix, 1e-9), np.arange(13) != 6
    assert not white[6].any()
    inverse = np.linalg.pinv(matrix[:, others].T @ matrix[:, others])
    assert_allclose((white @ white.T)[others][:, others], inverse, rtol=1e-9)
