"""The forward and inverse model of the sensors' errors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.linalg import inv
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import (
    ORIENTATIONS,
    PARAMETER_NAMES,
    SensorErrors,
    orientation_from_axes,
    orientation_to_axes,
)


@st.composite
def sensor_errors(draw, largest_deg=80.0):
    """Draw the errors of one to five sensors in any orientation with angles up to a limit."""
    count = draw(st.integers(1, 5))
    angle = arrays(float, (count, 3), elements=st.floats(-largest_deg, largest_deg).map(np.radians))
    return SensorErrors(
        draw(arrays(float, (count, 3), elements=st.floats(0.2, 5))),
        draw(angle),
        draw(arrays(float, (count, 3), elements=st.floats(-1e-4, 1e-4))),
        draw(angle),
        ORIENTATIONS[draw(arrays(int, count, elements=st.integers(0, 23)))],
    )


@given(sensor_errors(), st.integers(1, 6))
def test_restore_inverts_distort(errors, samples):
    """The inverse of the forward model is the field that went in, at each sensor."""
    field = np.random.default_rng(samples).uniform(-5e-5, 5e-5, (samples, errors.sensor_count, 3))
    condition = np.linalg.cond(errors.matrix).max()
    assert_allclose(errors.restore(errors.distort(field)), field, atol=1e-19 * condition + 1e-18 * condition)


@given(sensor_errors())
def test_uniform_field_goes_to_every_sensor(errors):
    """A field (N, 3) is the field (N, K, 3) with the same vector at all sensors."""
    field = np.array([[1e-5, -2e-5, 4e-5], [0, 0, 0]])
    repeated = np.repeat(field[:, None], errors.sensor_count, axis=1)
    assert_array_equal(errors.distort(field), errors.distort(repeated))
    assert_allclose(errors.distort(field)[1], errors.bias_T)


@given(sensor_errors())
def test_parameters_come_back_from_the_matrix(errors):
    """Scale factors and angles below 80° are found again in their product, where the orientation is known."""
    found = SensorErrors.from_matrix(errors.matrix, errors.bias_T, errors.orientation)
    assert_allclose(found.to_vector(), errors.to_vector(), rtol=1e-9, atol=1e-10)


@given(sensor_errors())
def test_orientation_keeps_the_angles_determined(errors):
    """The matrix is the same whatever was chosen; there is an orientation where β would exceed 45°, and only there."""
    found = SensorErrors.from_matrix(errors.matrix, errors.bias_T)
    assert_allclose(found.matrix, errors.matrix, atol=1e-9)
    is_turned = (found.orientation != np.eye(3)).any(axis=(1, 2))
    steep_deg = np.degrees(np.arcsin(np.abs(errors.rotation[:, 0, 2]).clip(0, 1)))
    assert_array_equal(is_turned[np.abs(steep_deg - 45) > 1e-6], (steep_deg > 45)[np.abs(steep_deg - 45) > 1e-6])
    assert (np.abs(found.misalignment[:, 1]) < np.radians(63)).all()


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_small_angles_in_any_orientation_stay_small(orientation):
    """A sensor that is mounted with exchanged axes has the misalignment that it has beside that, or none is steep."""
    angles = np.radians([[2.0, -3.0, 1.5]])
    none = SensorErrors.none(1)
    true = SensorErrors(none.scale_factor, none.non_orthogonality, none.bias_T, angles, orientation[None])
    found = SensorErrors.from_matrix(true.matrix, true.bias_T)
    if np.abs(true.rotation[0, 0, 2]) > 0.8:
        assert_array_equal(found.orientation, true.orientation)
        assert_allclose(found.misalignment, angles, atol=1e-12)
    else:
        assert_array_equal(found.orientation[0], np.eye(3))


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_orientation_has_names(orientation):
    """Which axis of the array each axis of the sensor points along says it all."""
    axes = orientation_to_axes(orientation)
    assert_array_equal(orientation_from_axes(axes), orientation)
    assert_array_equal(orientation @ np.array([1.0, 2.0, 3.0]), [_value(axis) for axis in axes])


def _value(axis):
    return {"x": 1.0, "y": 2.0, "z": 3.0}[axis[-1]] * (-1 if axis.startswith("-") else 1)


@given(sensor_errors())
def test_parameters_come_back_from_the_vector(errors):
    """The vector holds the parameters of each sensor in the order of their names."""
    vector = errors.to_vector()
    assert vector.shape == (errors.sensor_count, len(PARAMETER_NAMES))
    again = SensorErrors.from_vector(vector.ravel(), errors.orientation)
    assert_array_equal(again.to_vector(), vector)
    assert_array_equal(again.matrix, errors.matrix)
    assert_array_equal(vector[:, PARAMETER_NAMES.index("bias x")], errors.bias_T[:, 0])


@given(sensor_errors(largest_deg=60))
def test_jacobian_is_the_slope_of_matrix_and_bias(errors):
    """Each column agrees with central differences of [D Λ | o]."""
    step = 1e-6
    jacobian = errors.jacobian()
    vector = errors.to_vector()
    for parameter in range(12):
        change = np.zeros_like(vector)
        change[:, parameter] = step
        ends = [SensorErrors.from_vector(vector + sign * change, errors.orientation) for sign in (1, -1)]
        above, below = (np.concatenate([end.matrix, end.bias_T[:, :, None]], axis=2) for end in ends)
        assert_allclose(jacobian[..., parameter], (above - below) / (2 * step), atol=1e-8)


@given(sensor_errors(largest_deg=60))
def test_inverse_of_the_measurement_matrix_is_wus(errors):
    """D⁻¹ has the elements p1 to p6 of Wu 2025 eq. 4, with the signs that the print lost."""
    (sx, sy, sz), (theta, phi, psi) = errors.scale_factor.T, errors.non_orthogonality.T
    zero = np.zeros_like(sx)
    p1 = 1 / (np.cos(theta) * np.cos(phi) * sx)
    p2 = -np.tan(phi) / (np.cos(psi) * sy)
    skew = np.cos(theta) * np.sin(phi) * np.sin(psi) - np.sin(theta) * np.cos(psi)
    p3 = skew / (np.cos(theta) * np.cos(phi) * np.cos(psi) * sz)
    p4 = 1 / (np.cos(psi) * sy)
    p5 = -np.tan(psi) / sz
    p6 = 1 / sz
    expected = np.moveaxis(np.array([[p1, p2, p3], [zero, p4, p5], [zero, zero, p6]]), 2, 0)
    assert_allclose(inv(errors.measurement), expected, rtol=1e-9, atol=1e-9)


def test_rotations_are_passive():
    """Sensor axes turned by +90° about z read a field along x as minus y."""
    turned = SensorErrors(np.ones(3), np.zeros(3), np.zeros(3), np.array([0, 0, np.pi / 2]))
    assert_allclose(turned.distort(np.array([[1.0, 0, 0]]))[0, 0], [0, -1, 0], atol=1e-15)


def test_misalignment_turns_about_z_first():
    """Λ is Rx(α) Ry(β) Rz(γ), orthogonal with determinant 1."""
    angles = np.array([0.1, -0.2, 0.3])
    alone = [SensorErrors(np.ones(3), np.zeros(3), np.zeros(3), angles * axis).rotation[0] for axis in np.eye(3)]
    together = SensorErrors(np.ones(3), np.zeros(3), np.zeros(3), angles).rotation[0]
    assert_allclose(together, alone[0] @ alone[1] @ alone[2], atol=1e-15)
    assert_allclose(together @ together.T, np.eye(3), atol=1e-15)
    assert_allclose(np.linalg.det(together), 1)


def test_perfect_sensors_read_the_field():
    """Without errors the readings are the field."""
    field = np.array([[1e-5, 2e-5, -4e-5]])
    assert_array_equal(SensorErrors.none(3).distort(field), np.repeat(field[None], 3, axis=1))


ONES, ZEROS = np.ones((2, 3)), np.zeros((2, 3))


@pytest.mark.parametrize(
    ("make", "sentence"),
    [
        (lambda: SensorErrors(ONES, ZEROS[:1], ZEROS, ZEROS), r"non_orthogonality must have the shape .*not \(1, 3\)"),
        (lambda: SensorErrors(ONES[:, :2], ZEROS, ZEROS, ZEROS), r"scale_factor must have the shape .*not \(2, 2\)"),
        (lambda: SensorErrors(ONES, ZEROS, ZEROS * np.nan, ZEROS), "bias_T contains a value that is not finite"),
        (lambda: SensorErrors(ZEROS, ZEROS, ZEROS, ZEROS), "scale factors must be positive"),
        (lambda: SensorErrors(-ONES, ZEROS, ZEROS, ZEROS), "scale factors must be positive"),
        (
            lambda: SensorErrors.from_matrix(np.array([np.eye(3), np.diag([1, 1, -1.0])]), ZEROS),
            "sensor 2 has left-handed or dependent axes",
        ),
        (lambda: SensorErrors.from_matrix(np.zeros((1, 3, 3)), ZEROS[:1]), "sensor 1 has left-handed or dependent"),
        (
            lambda: SensorErrors(ONES, ZEROS, ZEROS, ZEROS, np.array([np.eye(3), np.diag([1, 1, -1.0])])),
            "the orientation of sensor 2 must .* stay right-handed",
        ),
    ],
)
def test_impossible_errors_are_refused(make, sentence):
    """Wrong shapes, values and handedness are named with their place."""
    with pytest.raises(InputError, match=sentence):
        make()
