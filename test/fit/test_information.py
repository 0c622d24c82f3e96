from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit.ellipsoid import free_scale
from tam_calibration.fit.information import InformationModel, bound, information_of
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

FIELD_T, NOISE_T = 5e-5, 1e-9


def sphere(count, seed=0):
    """Return fields of one intensity in random directions."""
    direction = np.random.default_rng(seed).standard_normal((count, 3))
    return FIELD_T * direction / np.linalg.norm(direction, axis=1, keepdims=True)


@pytest.mark.parametrize("scalar_noise_T", [0.1e-9, 1e-9])
def test_full_sphere_has_the_closed_form(scalar_noise_T):
    """On the full sphere the bound of every group is the closed form: bias, scale factor, angles, misalignment."""
    count = 40_000
    array = Array.cross(0.5, NOISE_T, scalar_noise_T)
    variance = np.diag(bound(sphere(count), SensorErrors.none(4), array, has_scalar=True)).reshape(4, 12)
    c = 0.25 + (scalar_noise_T / NOISE_T) ** 2
    relative = NOISE_T / FIELD_T
    expected = [relative**2 * (2.25 + 6 * c), relative**2 * (4.5 + 15 * c), NOISE_T**2 * (0.75 + 3 * c)]
    for group, value in enumerate(expected):
        assert np.mean(variance[:, 3 * group : 3 * group + 3]) * count == pytest.approx(value, rel=0.02)
    assert np.mean(variance[1:, 9:]) * count == pytest.approx(6 * relative**2, rel=0.02)


def test_bound_falls_with_the_number_of_samples():
    """Every variance is inversely proportional to the number of equal samples."""
    array, fields = Array.cross(0.5, NOISE_T, 1e-10), sphere(50)
    one = bound(fields, SensorErrors.none(4), array, has_scalar=True)
    four = bound(np.tile(fields, (4, 1)), SensorErrors.none(4), array, has_scalar=True)
    assert_allclose(4 * four, one, rtol=1e-6, atol=1e-24)


def test_fixed_scale_has_no_uncertainty_along_it():
    """Without a reference the covariance has none along the mean determinant that is held."""
    covariance = bound(sphere(100), SensorErrors.none(4), Array.cross(0.5, NOISE_T, 1e-10), has_scalar=False)
    along = np.zeros((4, 12))
    along[:, :3] = 1
    assert along.ravel() @ covariance @ along.ravel() == pytest.approx(0, abs=1e-20)


def array_of(count, vector_noise_T):
    """Return an array of so many sensors; where they sit does not matter in a uniform field."""
    return Array(np.zeros((count, 3)), np.array(vector_noise_T), 1e-10)


@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize("noise_T", [[1e-9] * 4, [1e-9, 5e-9, 1e-9, 2e-9], [1e-9]])
def test_variances_are_those_of_the_bound(true_errors, noise_T, has_scalar):
    """Taken apart or whole, the information gives the same covariance, of any sensors, with and without a scalar.

    The whole one is that of a fit of readings without noise.
    """
    errors = SensorErrors.from_vector(true_errors.to_vector()[: len(noise_T)])
    if not has_scalar:
        errors = SensorErrors.from_matrix(free_scale(errors.matrix) * errors.matrix, errors.bias_T)
    array, fields = array_of(len(noise_T), noise_T), sphere(60)
    scalar_T = np.full(60, FIELD_T) if has_scalar else None
    whole = maximum_likelihood(Recording(np.arange(60.0), errors.distort(fields), scalar_T), array).covariance
    size = np.sqrt(np.diag(whole) + (np.diag(whole) == 0))
    apart = bound(fields, errors, array, has_scalar)
    assert_allclose(apart / np.outer(size, size), whole / np.outer(size, size), rtol=0, atol=1e-9)


def test_one_more_sample_is_as_if_it_had_been_there(true_errors):
    """The variances with one more sample are those of the sum, for every sample."""
    model = InformationModel(true_errors, array_of(4, [1e-9] * 4), True, FIELD_T)
    known, candidates = information_of(model.rows(sphere(40))), model.rows(sphere(5, seed=1))
    expected = [model.variances(known + information_of(candidates[[index]])) for index in range(5)]
    assert_allclose(model.variances_with(known, candidates), expected, rtol=1e-9)


def test_errors_in_units_of_the_noise_do_not_depend_on_it():
    """Twice the noise, of vector and scalar, doubles every standard error and leaves it the same in units of noise."""
    quiet = InformationModel(SensorErrors.none(4), array_of(4, [1e-9] * 4), True, FIELD_T)
    loud = replace(quiet, array=Array(np.zeros((4, 3)), np.full(4, 2e-9), 2e-10))
    errors = [np.sqrt(model.variances(information_of(model.rows(sphere(50))))) for model in (quiet, loud)]
    assert_allclose(errors[1], 2 * errors[0], rtol=1e-9)
    assert_allclose(errors[1] * loud.noise_units, errors[0] * quiet.noise_units, rtol=1e-9)


def test_a_single_turn_leaves_what_a_constant_component_hides_open():
    """In one turn about z the z component is constant: biases trade with θ, ψ and Sz, and only φ stays known."""
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    fields = FIELD_T * np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(90, -0.8)], axis=1)
    array, errors = array_of(1, [NOISE_T]), SensorErrors.none(1)
    variance = np.diag(bound(fields, errors, array, True))
    assert np.isinf(variance[[2, 3, 5, 6, 7, 8]]).all() and np.isfinite(variance[4])
