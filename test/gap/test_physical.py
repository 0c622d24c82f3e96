"""What no sensor and no place on Earth has is told; the prior is the one whose bounds lie at 3.5 deviations."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.gap.physical import objection_to, prior_at, sensed_intensity
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.sensor_errors import SensorErrors

FIELD_T = 48e-6


def errors_of(*matrices):
    """Return errors of matrices D Λ without bias."""
    return SensorErrors.from_matrix(np.array(matrices, dtype=float), np.zeros((len(matrices), 3)))


def skewed(degrees):
    """Return a matrix whose second axis stands off the right angle to the third."""
    angle = np.radians(degrees)
    return np.array([[1, 0, 0], [0, np.cos(angle), np.sin(angle)], [0, 0, 1]])


@pytest.mark.parametrize(
    ("matrix", "intensity_T", "told"),
    [
        (np.eye(3), FIELD_T, None),
        (np.diag([0.1, 0.1, 0.1]), FIELD_T, None),
        (np.diag([1, 1.4, 1.9]), FIELD_T, None),
        (np.diag([1, 1.4, 2.1]), FIELD_T, "scale factors of sensor 2 that differ by a factor of 2.1"),
        (skewed(14), FIELD_T, None),
        (skewed(-16), FIELD_T, "axes of sensor 2 that stand 16 degrees off the right angle"),
        (Rotation.from_rotvec([2.0, 1.0, -0.5]).as_matrix(), FIELD_T, None),
        (np.eye(3), 14e-6, "a field of 14 µT, where the Earth's has 15 to 100"),
        (np.eye(3), 101e-6, "a field of 101 µT, where the Earth's has 15 to 100"),
    ],
)
def test_what_nothing_real_has_is_told(matrix, intensity_T, told):
    """The first sensor has no errors; gain and mounting are free."""
    assert objection_to(errors_of(np.eye(3), matrix), intensity_T, EARTH_FIELD) == told


@pytest.mark.parametrize("has_scalar", [True, False])
def test_the_score_is_the_slope_of_the_energy(has_scalar):
    """By differences of the energy over each element of the matrices."""
    generator = np.random.default_rng(3)
    matrix = np.eye(3) + 0.15 * generator.normal(size=(2, 3, 3))
    intensity_T = None if has_scalar else FIELD_T

    def energy(change):
        return prior_at(errors_of(*(matrix + change)), intensity_T, EARTH_FIELD).energy

    slope = np.zeros((2, 3, 4))
    for index in np.ndindex(2, 3, 3):
        step = np.zeros((2, 3, 3))
        step[index] = 1e-6
        slope[index] = (energy(step) - energy(-step)) / 2e-6
    assert_allclose(prior_at(errors_of(*matrix), intensity_T, EARTH_FIELD).score, -slope.ravel() / 2, atol=1e-6)


def test_bounds_lie_at_three_and_a_half_deviations():
    """An axis at the widest cosine, and the field at the ends of the Earth's, each cost 3.5²."""
    angle = np.degrees(np.arcsin(0.35))
    assert prior_at(errors_of(skewed(angle)), None, EARTH_FIELD).energy == pytest.approx(3.5**2, rel=0.01)
    assert prior_at(errors_of(np.eye(3)), 15e-6, EARTH_FIELD).energy == pytest.approx(3.5**2, rel=0.01)
    assert prior_at(errors_of(np.eye(3)), np.sqrt(15 * 100) * 1e-6, EARTH_FIELD).energy == pytest.approx(0, abs=1e-9)


def test_two_axes_that_differ_by_the_largest_ratio_cost_as_much():
    """Of logarithms with deviations σ the difference has √2 σ; what the third adds is left out by placing it midway."""
    energy = prior_at(errors_of(np.diag([1, np.sqrt(2), 2])), None, EARTH_FIELD).energy
    assert energy == pytest.approx(3.5**2, rel=0.01)


def test_the_intensity_is_told_in_the_unit_that_suits_the_earth():
    """A sensor that reads ten times as much, or a tenth, beside one without errors."""
    for gain in (0.1, 10):
        assert sensed_intensity(errors_of(gain * np.eye(3), np.eye(3)), FIELD_T, EARTH_FIELD) == pytest.approx(FIELD_T)
    assert sensed_intensity(errors_of(2 * np.eye(3), 4 * np.eye(3)), FIELD_T, EARTH_FIELD) == pytest.approx(2 * FIELD_T)


def test_bounds_of_another_field_take_the_place_of_the_earths():
    """A coil of 500 µT: the prior stands about its middle, and the Earth's field is none of it."""
    coil = FieldBounds(400e-6, 625e-6)
    assert objection_to(errors_of(np.eye(3)), 500e-6, coil) is None
    assert objection_to(errors_of(np.eye(3)), FIELD_T, coil) == "a field of 48 µT, where the array's has 400 to 625"
    assert prior_at(errors_of(np.eye(3)), 400e-6, coil).energy == pytest.approx(3.5**2, rel=0.01)
    assert prior_at(errors_of(np.eye(3)), 500e-6, coil).energy == pytest.approx(0, abs=1e-9)
    assert sensed_intensity(errors_of(0.1 * np.eye(3), np.eye(3)), 500e-6, coil) == pytest.approx(500e-6)
