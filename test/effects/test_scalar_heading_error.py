"""A scalar magnetometer with heading error."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.effects.scalar_heading_error import ScalarHeadingError
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


@pytest.mark.parametrize("kind", ["cubic", "cusp"])
def test_the_axis_is_found(sphere, left_by, kind):
    """Among the few that are tried is the true one, to a hundredth of a radian."""
    true = np.array([np.cos(0.4) * np.cos(0.7), np.cos(0.4) * np.sin(0.7), np.sin(0.4)])
    cosine = sphere.field_T @ true / sphere.intensity_T
    error = 3e-9 * (cosine**3 if kind == "cubic" else np.abs(cosine))

    class Heading(ScalarHeadingError):
        def signal(self, covariates, fitted):
            return np.column_stack([np.zeros((1200, 12)), error])

    tried = EFFECT.shapes(sphere, left_by(Heading(), sphere, {}))
    assert tried[0] == {}
    found = [(shape["azimuth_rad"], shape["elevation_rad"]) for shape in tried[1:]]
    axes = [[np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)] for round_, up in found]
    assert 1 <= len(axes) <= 4
    assert np.abs(axes @ true).max() > np.cos(0.04)


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


def test_three_axes_apart_from_each_other_are_tried(sphere, left_by):
    """Where there is one, the two others begin seventeen degrees off and climb towards it."""
    direction = sphere.field_T / sphere.intensity_T[:, None]

    class Heading(ScalarHeadingError):
        def signal(self, covariates, fitted):
            return np.column_stack([np.zeros((1200, 12)), 3e-9 * direction[:, 0] ** 3])

    tried = EFFECT.shapes(sphere, left_by(Heading(), sphere, {}))[1:]
    up, round_ = (np.array([shape[name] for shape in tried]) for name in ("elevation_rad", "azimuth_rad"))
    axes = np.column_stack([np.cos(up) * np.cos(round_), np.cos(up) * np.sin(round_), np.sin(up)])
    off = np.arccos(np.abs(axes[:, 0]))
    assert len(axes) == 3 and off[0] < 0.03
    assert (off[1:] > 0.1).all() and (off[1:] < 0.3).all()


@pytest.mark.parametrize(("samples", "is_told"), [(15, False), (25, True)])
def test_axes_are_sought_where_samples_outnumber_what_a_calibration_makes(sphere, left_by, samples, is_told):
    """Twice the nine harmonics up to the second degree."""
    few = sphere.take(slice(samples))
    assert (len(EFFECT.shapes(few, left_by(EFFECT, few, {}))) > 1) == is_told
