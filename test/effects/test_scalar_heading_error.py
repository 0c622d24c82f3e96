"""A scalar magnetometer with heading error."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.effects.curves import ScalarHeadingError
from tam_calibration.model.fitted_effect import SCALAR

EFFECT = ScalarHeadingError()
AXIS = {"azimuth_rad": 0.7, "elevation_rad": 0.4}


@pytest.fixture(scope="module")
def sphere(turning):
    """Return covariates with fields from all directions."""
    return turning(attitude=Rotation.random(1200, random_state=2).as_quat())


def test_coefficients_come_back(sphere, refitted):
    """Harmonics of all degrees, and polynomials about an axis, are told apart."""
    deviation, _ = refitted(EFFECT, sphere, {}, *((SCALAR, None, f"degree {degree}") for degree in (3, 4, 5, 6)))
    assert np.abs(deviation).max() < 4
    keys = [(SCALAR, None, f"about an axis, degree {degree}") for degree in (3, 4, 5, 7)]
    deviation, error = refitted(EFFECT, sphere, AXIS, *keys)
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


def test_axes_of_all_directions_are_tried(sphere):
    """Any function of the direction first; each axis is within twenty degrees of one that is tried."""
    first, *others = EFFECT.shapes(sphere, None)
    up, around = (np.array([shape[name] for shape in others]) for name in ("elevation_rad", "azimuth_rad"))
    tried = np.column_stack([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])
    drawn = np.random.default_rng(1).normal(size=(2000, 3))
    drawn /= np.linalg.norm(drawn, axis=1)[:, None]
    assert first == {}
    assert np.abs(drawn @ tried.T).max(axis=1).min() > np.cos(np.deg2rad(20))


def test_directions_on_a_narrow_cone_show_nothing(turning, sphere):
    """Within some degrees every function of the direction is inside the calibration."""
    narrow = Rotation.from_rotvec(0.02 * np.random.default_rng(1).normal(size=(1200, 3))).as_quat()
    assert "enough directions" in EFFECT.obstacle(turning(attitude=narrow))
    assert EFFECT.obstacle(sphere) is None


@pytest.mark.parametrize(("size", "is_enough"), [(0.21, False), (0.25, True)])
def test_a_slight_part_of_the_third_degree_is_enough(turning, size, is_enough):
    """A cone of twelve degrees leaves less beside the calibration, one of fourteen leaves more."""
    cone = Rotation.from_rotvec(size * np.random.default_rng(1).normal(size=(1200, 3))).as_quat()
    assert (EFFECT.obstacle(turning(attitude=cone)) is None) == is_enough
