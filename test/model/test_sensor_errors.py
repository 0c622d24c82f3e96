"""The forward and inverse model of the sensors' errors.

The floor of the residuals is what noise alone leaves of them: draws of it, corrected with the true errors.
"""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest
from numpy.linalg import inv
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import (
    ORIENTATIONS,
    PARAMETER_NAMES,
    ResidualSums,
    SensorErrors,
    measure_residuals,
    noise_floor,
    orientation_from_axes,
    orientation_to_axes,
)
from tam_calibration.model.units import from_degrees


def drawn(largest_deg):
    """Return the errors of 300 sensors in all orientations, with angles up to a limit: none, the limits, and others."""
    rng = np.random.default_rng(7)
    angles = from_degrees(rng.choice([-largest_deg, 0, 1e-6, largest_deg], (2, 300, 3)))
    angles[:, 100:] = from_degrees(rng.uniform(-largest_deg, largest_deg, (2, 200, 3)))
    scale, bias_T = np.exp(rng.uniform(np.log(0.2), np.log(5), (300, 3))), rng.uniform(-1e-4, 1e-4, (300, 3))
    bias_T[::10] = 0
    return SensorErrors(scale, angles[0], bias_T, angles[1], ORIENTATIONS[np.arange(300) % 24])


ERRORS, LESS = drawn(80.0), drawn(60.0)


def test_restore_inverts_distort():
    """The inverse of the forward model is the field that went in, at each sensor."""
    field = np.random.default_rng(6).uniform(-5e-5, 5e-5, (6, 300, 3))
    off = np.abs(ERRORS.restore(ERRORS.distort(field)) - field)
    assert (off <= 1.1e-18 * np.linalg.cond(ERRORS.matrix)[:, None]).all()


def test_uniform_field_goes_to_every_sensor():
    """A field (N, 3) is the field (N, K, 3) with the same vector at all sensors."""
    field = np.array([[1e-5, -2e-5, 4e-5], [0, 0, 0]])
    assert_array_equal(ERRORS.distort(field), ERRORS.distort(np.repeat(field[:, None], 300, axis=1)))
    assert_allclose(ERRORS.distort(field)[1], ERRORS.bias_T)


def test_parameters_come_back_from_the_matrix():
    """Scale factors and angles up to 80° are found again in their product, where the orientation is known."""
    found = SensorErrors.from_matrix(ERRORS.matrix, ERRORS.bias_T, ERRORS.orientation)
    assert_allclose(found.to_vector(), ERRORS.to_vector(), rtol=1e-9, atol=1e-10)


def test_orientation_keeps_the_angles_determined():
    """The matrix is the same whatever was chosen; there is an orientation where β would exceed 45°, and only there."""
    found = SensorErrors.from_matrix(ERRORS.matrix, ERRORS.bias_T)
    assert_allclose(found.matrix, ERRORS.matrix, atol=1e-9)
    is_turned = (found.orientation != np.eye(3)).any(axis=(1, 2))
    steep_deg = np.degrees(np.arcsin(np.abs(ERRORS.rotation[:, 0, 2]).clip(0, 1)))
    is_clear = np.abs(steep_deg - 45) > 1e-6
    assert_array_equal(is_turned[is_clear], (steep_deg > 45)[is_clear])
    assert (np.abs(found.misalignment[:, 1]) < np.radians(63)).all()


def test_small_angles_in_any_orientation_stay_small():
    """A sensor that is mounted with exchanged axes has the misalignment that it has beside that, or none is steep."""
    angles, none = np.tile(np.radians([2.0, -3.0, 1.5]), (24, 1)), SensorErrors.none(24)
    true = SensorErrors(none.scale_factor, none.non_orthogonality, none.bias_T, angles, ORIENTATIONS)
    found, is_steep = SensorErrors.from_matrix(true.matrix, true.bias_T), np.abs(true.rotation[:, 0, 2]) > 0.8
    assert 0 < np.count_nonzero(is_steep) < 24
    assert_array_equal(found.orientation, np.where(is_steep[:, None, None], ORIENTATIONS, np.eye(3)))
    assert_allclose(found.misalignment[is_steep], angles[is_steep], atol=1e-12)


def test_orientation_has_names():
    """Which axis of the array each axis of the sensor points along says it all."""
    value = {"x": 1.0, "y": 2.0, "z": 3.0, "-x": -1.0, "-y": -2.0, "-z": -3.0}
    for orientation in ORIENTATIONS:
        axes = orientation_to_axes(orientation)
        assert_array_equal(orientation_from_axes(axes), orientation)
        assert_array_equal(orientation @ np.array([1.0, 2.0, 3.0]), [value[axis] for axis in axes])


def test_parameters_come_back_from_the_vector():
    """The vector holds the parameters of each sensor in the order of their names."""
    vector = ERRORS.to_vector()
    assert vector.shape == (300, len(PARAMETER_NAMES))
    again = SensorErrors.from_vector(vector.ravel(), ERRORS.orientation)
    assert_array_equal(again.to_vector(), vector)
    assert_array_equal(again.matrix, ERRORS.matrix)
    assert_array_equal(vector[:, PARAMETER_NAMES.index("bias x")], ERRORS.bias_T[:, 0])


def test_jacobian_is_the_slope_of_matrix_and_bias():
    """Each column agrees with central differences of [D Λ | o]."""
    step, jacobian, vector = 1e-6, LESS.jacobian(), LESS.to_vector()
    for parameter in range(12):
        change = step * np.eye(12)[parameter]
        ends = [SensorErrors.from_vector(vector + sign * change, LESS.orientation) for sign in (1, -1)]
        above, below = (np.concatenate([end.matrix, end.bias_T[:, :, None]], axis=2) for end in ends)
        assert_allclose(jacobian[..., parameter], (above - below) / (2 * step), atol=1e-8)


def test_inverse_of_the_measurement_matrix_is_wus():
    """D⁻¹ has the elements p1 to p6 of Wu 2025 eq. 4, with the signs that the print lost."""
    (sx, sy, sz), (theta, phi, psi) = LESS.scale_factor.T, LESS.non_orthogonality.T
    zero = np.zeros_like(sx)
    p1 = 1 / (np.cos(theta) * np.cos(phi) * sx)
    p2 = -np.tan(phi) / (np.cos(psi) * sy)
    skew = np.cos(theta) * np.sin(phi) * np.sin(psi) - np.sin(theta) * np.cos(psi)
    p3 = skew / (np.cos(theta) * np.cos(phi) * np.cos(psi) * sz)
    p4 = 1 / (np.cos(psi) * sy)
    p5 = -np.tan(psi) / sz
    p6 = 1 / sz
    expected = np.moveaxis(np.array([[p1, p2, p3], [zero, p4, p5], [zero, zero, p6]]), 2, 0)
    assert_allclose(inv(LESS.measurement), expected, rtol=1e-9, atol=1e-9)


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


@pytest.fixture(scope="module")
def uneven():
    """Return errors whose axes differ by a factor of three: only the mean over all directions then is the floor."""
    errors = SensorErrors.none(4)
    return replace(errors, scale_factor=errors.scale_factor * np.array([0.5, 1.0, 1.5]))


@pytest.mark.parametrize("has_scalar", [True, False])
def test_residuals_of_parts_add_up_to_those_of_all_samples(uneven, has_scalar):
    """Sums of 30 and 10 samples; where a part has no intensity, that of the other counts alone."""
    generator = np.random.default_rng(2)
    array, scalar_T = Array.cross(0.5), 5e-5 + 1e-8 * generator.normal(size=40)
    readings = uneven.distort(3e-5 * generator.normal(size=(40, 3)))
    recording = Recording(np.arange(40.0), readings, scalar_T if has_scalar else None)
    parts = [recording.take(slice(30)), recording.take(slice(30, 40))]
    added = reduce(ResidualSums.plus, (ResidualSums.of(uneven, array, part, 5e-5) for part in parts)).result()
    whole = measure_residuals(uneven, array, recording, 5e-5)
    assert_allclose(added.sensor_intensity_T, whole.sensor_intensity_T)
    assert added.center_intensity_T == pytest.approx(whole.center_intensity_T)
    assert_allclose(added.tensor_T_per_m, whole.tensor_T_per_m)
    first = ResidualSums.of(uneven, array, parts[0], 5e-5)
    unread = ResidualSums.of(uneven, array, replace(parts[1], scalar_T=None), np.nan)
    assert first.plus(unread).result().center_intensity_T == pytest.approx(first.result().center_intensity_T)


@pytest.mark.parametrize("scalar_noise_T", [0.0, 3e-9])
def test_the_floor_is_what_noise_alone_leaves(uneven, scalar_noise_T):
    """Of 40 000 directions all over the sphere, to a per cent."""
    generator = np.random.default_rng(4)
    array = Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=scalar_noise_T)
    array = replace(array, vector_noise_T=np.array([1e-9, 2e-9, 3e-9, 4e-9]))
    direction = generator.normal(size=(40_000, 3))
    field = 5e-5 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    noise = array.vector_noise_T[:, None] * generator.normal(size=(len(field), 4, 3))
    scalar = 5e-5 + scalar_noise_T * generator.normal(size=len(field))
    recording = Recording(np.arange(len(field)) / 100, uneven.distort(field) + noise, scalar)
    left, floor = measure_residuals(uneven, array, recording, 5e-5), noise_floor(uneven, array, scalar_noise_T)
    assert_allclose(left.sensor_intensity_T, floor.sensor_intensity_T, rtol=0.02)
    assert left.center_intensity_T == pytest.approx(floor.center_intensity_T, rel=0.02)
    assert_allclose(left.tensor_T_per_m, floor.tensor_T_per_m, rtol=0.02)
