"""The field of a sample is eliminated as by least squares, and what is left is white and free of it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.least_squares import Elimination
from tam_calibration.model.sensor_errors import SensorErrors


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
