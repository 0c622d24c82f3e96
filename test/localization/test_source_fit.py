"""Many dipoles side by side as problems of least squares: derivatives, and that none depends on another."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.localization.source_fit import Dipoles, fit_fields
from tam_calibration.sources.dipole import dipole_field

GENERATOR = np.random.default_rng(6)
POINTS = GENERATOR.normal(size=(8, 3)) * 0.3
PLACES = np.array([[2.0, 1.0, -1.5], [-1.0, 2.5, 0.5], [0.5, -2.0, 2.0]])
MOMENTS = np.array([[10.0, -20.0, 30.0], [5.0, 15.0, -10.0], [-20.0, 4.0, 8.0]])
TRUTH = np.concatenate([PLACES, MOMENTS], axis=1)
COMMON = 1e7 * GENERATOR.normal(size=(20, 24))
OWN = COMMON * np.array([1.0, 2.0, 0.5])[:, None, None]
ALL = np.arange(3)


def test_data_are_the_weighted_fields():
    """Of eight points, for three dipoles at once, in any order."""
    data, _ = Dipoles(POINTS, OWN).predict(TRUTH[::-1], ALL[::-1])
    for at, (place, moment) in enumerate(zip(PLACES, MOMENTS, strict=True)):
        field = dipole_field(POINTS - place, np.tile(moment, (8, 1)))[0].ravel()
        assert_allclose(data[2 - at], OWN[at] @ field, rtol=1e-12)


def test_derivatives_are_those_of_differences():
    """By place and moment."""
    dipoles = Dipoles(POINTS, OWN)
    derivative = dipoles.predict(TRUTH, ALL)[1]
    assert derivative.shape == (3, 20, 6)
    for column, step in enumerate(1e-5 * np.eye(6)):
        expected = (dipoles.predict(TRUTH + step, ALL)[0] - dipoles.predict(TRUTH - step, ALL)[0]) / 2e-5
        assert_allclose(derivative[..., column], expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_with_the_moment_that_fits_best_the_place_alone_leads_to_the_truth():
    """Derivatives are exact where nothing is left, and the moment there is the true one."""
    dipoles = Dipoles(POINTS, OWN)
    data = dipoles.predict(TRUTH, ALL)[0]
    assert_allclose(dipoles.with_strengths(data, PLACES, ALL)[0], TRUTH, rtol=1e-9)
    derivative = dipoles.predict_projected(data, PLACES, ALL)[1]
    for column, step in enumerate(1e-4 * np.eye(3)):
        after, before = (dipoles.predict_projected(data, PLACES + each, ALL)[0] for each in (step, -step))
        assert_allclose(derivative[..., column], (after - before) / 2e-4, atol=1e-5 * np.abs(derivative).max())


def test_a_fit_settles_from_far_along_the_valley():
    """Of a place that is half as far again, whose moment makes nearly the same field."""
    values = Dipoles(POINTS, np.broadcast_to(COMMON, (3, 20, 24))).predict(TRUTH, ALL)[0]
    start = np.concatenate([1.5 * PLACES, 1.5**3 * MOMENTS], axis=1)
    solution = fit_fields(values, POINTS, COMMON, np.eye(20), start)
    assert solution.is_found.all()
    assert_allclose(solution.unknowns, TRUTH, rtol=1e-9)


@pytest.mark.parametrize("noise", [np.eye(20), np.eye(20) * np.array([1.0, 4.0, 9.0])[:, None, None]])
def test_each_problem_is_solved_as_if_alone(noise):
    """From places a few decimetres off, whatever its neighbours do; one that begins at the truth stays."""
    values = Dipoles(POINTS, np.broadcast_to(COMMON, (3, 20, 24))).predict(TRUTH, ALL)[0]
    start = TRUTH.copy()
    start[:, :3] += np.array([[0.3, -0.2, 0.1], [0.0, 0.0, 0.0], [-0.1, 0.2, 0.2]])
    solution = fit_fields(values, POINTS, COMMON, noise, start)
    assert solution.is_found.all()
    assert_allclose(solution.unknowns, TRUTH, rtol=1e-9)
    for at in range(3):
        own = noise if noise.ndim == 2 else noise[at]
        alone = fit_fields(values[at : at + 1], POINTS, COMMON, own, start[at : at + 1])
        assert_allclose(alone.unknowns[0], solution.unknowns[at], rtol=1e-12)
