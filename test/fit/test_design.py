from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.array import Array
from tam_calibration.fit.bound import bound
from tam_calibration.fit.design import Model, Rows
from tam_calibration.fit.scale import free_scale
from tam_calibration.sensor_errors import SensorErrors

FIELD_T = 5e-5


def sphere(count, seed=0):
    """Return fields of one intensity in random directions."""
    direction = np.random.default_rng(seed).standard_normal((count, 3))
    return FIELD_T * direction / np.linalg.norm(direction, axis=1, keepdims=True)


def array_of(count, vector_noise_T):
    """Return an array of so many sensors; where they sit does not matter in a uniform field."""
    return Array(np.zeros((count, 3)), np.array(vector_noise_T), 1e-10)


@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize("noise_T", [[1e-9] * 4, [1e-9, 5e-9, 1e-9, 2e-9], [1e-9]])
def test_variances_are_those_of_the_bound(true_errors, noise_T, has_scalar):
    """Taken apart or whole, the information gives the same variances, of any sensors, with and without a scalar."""
    errors = SensorErrors.from_vector(true_errors.to_vector()[: len(noise_T)])
    if not has_scalar:
        errors = SensorErrors.from_matrix(free_scale(errors.matrix) * errors.matrix, errors.bias_T)
    array, fields = array_of(len(noise_T), noise_T), sphere(60)
    model = Model(errors, array, has_scalar, FIELD_T)
    expected = np.diag(bound(fields, errors, array, has_scalar))
    assert_allclose(model.variances(model.rows(fields).information), expected, rtol=1e-9)


def test_what_a_turn_leaves_open_is_infinite_as_in_the_bound():
    """One turn about z leaves the same parameters open."""
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    fields = FIELD_T * np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(90, -0.8)], axis=1)
    array, errors = array_of(4, [1e-9] * 4), SensorErrors.none(4)
    model = Model(errors, array, True, FIELD_T)
    variances = model.variances(model.rows(fields).information)
    assert (np.isinf(variances) == np.isinf(np.diag(bound(fields, errors, array, True)))).all()
    assert np.isinf(variances).any() and np.isfinite(variances).any()


def test_one_more_sample_is_as_if_it_had_been_there(true_errors):
    """The variances with one more sample are those of the sum, for every sample."""
    model = Model(true_errors, array_of(4, [1e-9] * 4), True, FIELD_T)
    known, candidates = model.rows(sphere(40)).information, model.rows(sphere(5, seed=1))
    expected = [model.variances(known + candidates[[index]].information) for index in range(5)]
    assert_allclose(model.variances_with(known, candidates), expected, rtol=1e-9)


def test_information_adds_up(true_errors):
    """Three times the samples are three times the information, and rows that are three times as many."""
    model = Model(true_errors, array_of(4, [1e-9] * 4), True, FIELD_T)
    rows = model.rows(sphere(20))
    three = Rows(np.tile(rows.ellipsoid, (3, 1)), np.tile(rows.affine, (3, 1))).information
    assert_allclose((rows.information * 3).ellipsoid, three.ellipsoid, rtol=1e-12)
    assert_allclose((rows.information + rows.information * 2).affine, three.affine, rtol=1e-12, atol=1e-9)


def test_errors_in_units_of_the_noise_do_not_depend_on_it():
    """Twice the noise, of vector and scalar, doubles every standard error and leaves it the same in units of noise."""
    quiet = Model(SensorErrors.none(4), array_of(4, [1e-9] * 4), True, FIELD_T)
    loud = replace(quiet, array=Array(np.zeros((4, 3)), np.full(4, 2e-9), 2e-10))
    errors = [np.sqrt(model.variances(model.rows(sphere(50)).information)) for model in (quiet, loud)]
    assert_allclose(errors[1], 2 * errors[0], rtol=1e-9)
    assert_allclose(errors[1] * loud.noise_units, errors[0] * quiet.noise_units, rtol=1e-9)
