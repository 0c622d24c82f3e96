"""Dipoles of single samples beside a regional field that is uncertain."""

import numpy as np
import pytest
from numpy.linalg import norm

from tam_calibration.localization.solutions import Status
from tam_calibration.localization.turned_samples import Regional, Samples, locate_samples
from tam_calibration.model.array import Array
from tam_calibration.sources.dipole import dipole_field

EARTH_T = np.array([1e-6, 21e-6, -43e-6])
ERROR_T = 20e-9
ARRAY = Array.cross(0.5, 1e-10, 1e-10)
COVARIANCE = ARRAY.operator @ ARRAY.operator.T * 1e-20
COUNT = 1000


@pytest.fixture(scope="module")
def near():
    """Return dipoles 2 to 6 m away whose field is 4 to 20 times the regional field's error, and what is located."""
    generator = np.random.default_rng(8)
    places, moments = generator.normal(size=(2, COUNT, 3))
    places *= generator.uniform(2, 6, (COUNT, 1)) / norm(places, axis=1, keepdims=True)
    own = norm(dipole_field(-places, moments)[0], axis=1)
    moments *= (ERROR_T * generator.uniform(4, 20, COUNT) / own)[:, None]
    points = (ARRAY.positions_m - places[:, None]).reshape(-1, 3)
    fields = dipole_field(points, np.repeat(moments, 4, axis=0))[0].reshape(COUNT, 4, 3)
    fields += EARTH_T + ERROR_T * generator.normal(size=(COUNT, 1, 3)) + 1e-10 * generator.normal(size=fields.shape)
    regional = Regional(EARTH_T, covariance_T2=ERROR_T**2 * np.eye(3))
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (COUNT, 1))
    outputs = fields.reshape(COUNT, -1) @ ARRAY.operator.T
    return places, locate_samples(Samples(outputs, ARRAY, COVARIANCE, attitude), regional)


def pulls_of(near):
    """Return the errors (n, 3) of what was located over their standard errors."""
    places, found = near
    at = found.is_located
    errors = np.sqrt(np.diagonal(found.position_covariance_m2[at], axis1=1, axis2=2))
    return (found.position_m[at] - places[at]) / errors


def test_intervals_cover_beside_an_uncertain_field(near):
    """At the least favourable strength 95 % intervals hold 92 % or more."""
    assert 0.92 < np.mean(np.abs(pulls_of(near)) < 1.96) < 0.97


def test_several_solutions_are_ambiguous_rather_than_wrong(near):
    """Beyond five standard errors are fewer than 0.8 % at the least favourable strength; with a single start more."""
    assert np.mean(near[1].status == Status.AMBIGUOUS) > 0.05
    assert np.mean(np.abs(pulls_of(near)) > 5) < 0.008


def test_a_dipole_that_is_no_stronger_than_the_error_beside_it_is_refused(near):
    """Below five standard errors of the regional field what is found follows its error."""
    found = near[1]
    at = found.is_located
    strength = norm(dipole_field(-found.position_m[at], found.moment_Am2[at])[0], axis=1) / ERROR_T
    assert 5 < strength.min() < 5.5
    assert (found.status == Status.NO_FIELD).any()


def test_a_strong_dipole_needs_one_start():
    """Above fifty standard errors a sample is what it is with an exact regional field, but for its covariance."""
    place, moment = np.array([[2.0, 1.5, -1.7]]), np.array([[50.0, -80.0, 120.0]])
    field = dipole_field(ARRAY.positions_m - place, np.repeat(moment, 4, axis=0))[0]
    outputs = (field + EARTH_T).reshape(1, -1) @ ARRAY.operator.T
    error = norm(dipole_field(-place, moment)[0]) / 60
    regional = Regional(EARTH_T, covariance_T2=error**2 * np.eye(3))
    found = locate_samples(Samples(outputs, ARRAY, COVARIANCE, np.array([[0.0, 0.0, 0.0, 1.0]])), regional)
    np.testing.assert_allclose(found.position_m, place, rtol=1e-6)
