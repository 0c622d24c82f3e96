import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.array import Array
from tam_calibration.fit.bound import bound
from tam_calibration.sensor_errors import SensorErrors

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


def test_a_single_turn_leaves_what_a_constant_component_hides_open():
    """In one turn about z the z component is constant: biases trade with θ, ψ and Sz, and only φ stays known."""
    angle = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    fields = FIELD_T * np.stack([0.6 * np.cos(angle), 0.6 * np.sin(angle), np.full(90, -0.8)], axis=1)
    array = Array(np.zeros((1, 3)), np.array([NOISE_T]), 1e-10)
    variance = np.diag(bound(fields, SensorErrors.none(1), array, has_scalar=True))
    assert np.isinf(variance[[2, 3, 5, 6, 7, 8]]).all()
    assert np.isfinite(variance[4])
