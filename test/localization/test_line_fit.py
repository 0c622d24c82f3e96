"""Lines of current and of dipoles, fitted with the array's true baselines."""

from functools import partial

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.core.least_squares import with_slopes
from tam_calibration.localization.euler import locate
from tam_calibration.localization.source_fit import _field, _nearest
from tam_calibration.localization.turned_samples import Samples, locate_each
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError

ARRAY = Array.cross(0.5, vector_noise_T=1e-10)
NOISE = ARRAY.operator @ ARRAY.operator.T * 1e-20
COUNT = 300


def current(across):
    """Return the field (…, 3) of a current along z at points across it, to a factor."""
    return np.cross([0.0, 0.0, 1.0], across) / np.sum(across**2, axis=-1, keepdims=True)


def dipoles(across):
    """Return the field (…, 3) of a line of dipoles along z, their moment along x, to a factor."""
    square = np.sum(across**2, axis=-1, keepdims=True)
    return (2 * across * across[..., :1] / square - [1.0, 0.0, 0.0]) / square


FIELDS = {1: current, 2: dipoles}


def crossed(index, seed=2):
    """Return the nearest points (N, 3) of lines 2 to 8 m away in all directions, and the readings (N, K, 3) of them."""
    rng = np.random.default_rng(seed)
    turns = Rotation.random(COUNT, random_state=seed).as_matrix()
    angle, distance = rng.uniform(0, 2 * np.pi, COUNT), rng.uniform(2, 8, COUNT)
    place = distance[:, None] * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(COUNT)])
    points = np.einsum("nij,kj->nki", turns, ARRAY.positions_m) - place[:, None]
    points[..., 2] = 0.0
    return np.einsum("nji,nj->ni", turns, place), np.einsum("nji,nkj->nki", turns, 1e-6 * FIELDS[index](points))


def outputs_of(readings):
    """Return outputs (N, 9) of readings (N, K, 3)."""
    return readings.reshape(len(readings), -1) @ ARRAY.operator.T


@pytest.mark.parametrize("index", [1, 2])
def test_error_of_finite_baselines_is_gone(index):
    """Euler's solution bends with the field over the baselines by per mille, the fit by nothing; there is no moment."""
    places, readings = crossed(index)
    euler, found = (
        locate(outputs_of(readings), index=index),
        locate_each(Samples(outputs_of(readings), ARRAY, NOISE, index=index)),
    )
    distance = norm(places, axis=1)
    assert (norm(euler.position_m - places, axis=1) / distance).max() > 5e-3
    assert found.is_located.all()
    assert_allclose(found.position_m, places, atol=1e-8)
    assert np.isnan(found.moment_Am2).all()


@pytest.mark.parametrize("index", [1, 2])
def test_intervals_are_those_of_noise(index):
    """Squared errors over their covariance are χ² of three, but for the direction along the line."""
    places, readings = crossed(index)
    noisy = readings + 1e-10 * np.random.default_rng(3).normal(size=readings.shape)
    found = locate_each(Samples(outputs_of(noisy), ARRAY, NOISE, index=index))
    at = found.is_located
    off, covariance = found.position_m[at] - places[at], found.position_covariance_m2[at]
    pulls = off / np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1, abs=0.08)
    assert found.chi_square[at].mean() == pytest.approx(3 if index == 1 else 2, abs=0.4)


@pytest.mark.parametrize(("index", "unknowns"), [(1, 5), (2, 6)])
def test_derivatives_are_those_of_differences(index, unknowns):
    """Of the field, and of the nearest point and the direction."""
    rng = np.random.default_rng(1)
    points, at = rng.normal(size=(3, 4, 3)), rng.normal(size=(3, unknowns)) + 3
    for function in (partial(_field, points, index), _nearest):
        _, slopes = with_slopes(function, at)
        for number, change in enumerate(1e-6 * np.eye(unknowns)):
            difference = (function(at + change) - function(at - change)) / 2e-6
            assert_allclose(slopes[..., number], difference, rtol=1e-5, atol=1e-8)


def test_another_index_is_refused():
    """Intervals are those of a source that is known: a dipole or a line."""
    with pytest.raises(InputError, match="structural index must be 3 of a dipole"):
        Samples(np.zeros((1, 9)), ARRAY, NOISE, index=2.5)
