"""Arms that bend under their weight."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.courses import Flexure
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

EFFECT = Flexure()


def test_it_is_a_small_rotation_of_the_sensor(turning):
    """A sensor that turns about x by the gravity along y reads the field turned so far."""
    covariates = turning()
    values = {"turn about x by weight along y": 1e-6}
    fitted = FittedEffect(EFFECT.name, {}, (Contribution(2, None, "turn", values),))
    upwards = Rotation.from_quat(covariates.attitude).inv().apply([0, 0, 1])
    turns = Rotation.from_rotvec(np.outer(1e-6 * upwards[:, 1], [1, 0, 0]))
    expected = (turns.apply(covariates.field_T) - covariates.field_T) @ covariates.errors.matrix[2].T
    added = EFFECT.signal(covariates, fitted)
    assert_allclose(added[:, 6:9], expected, atol=1e-16)
    assert not np.delete(added, [6, 7, 8], axis=1).any()


def test_where_no_bending_can_be_seen(turning):
    """An array that keeps level, whatever its heading, or has a single sensor does not show it."""
    level = Rotation.from_rotvec(np.outer(np.linspace(0, 20, 1200), [0, 0, 1])).as_quat()
    assert "tilted by 0.00 rad only" in EFFECT.obstacle(turning(attitude=level))
    assert "single sensor" in EFFECT.obstacle(turning(sensors=1))
    assert EFFECT.obstacle(turning()) is None


@pytest.mark.parametrize(("tilt", "is_enough"), [(0.07, False), (0.14, True)])
def test_a_tilt_by_six_degrees_bends_an_arm(turning, tilt, is_enough):
    """Less is what attitudes err by."""
    angle = np.sqrt(2) * tilt * np.sin(np.linspace(0, 20 * np.pi, 1200))
    covariates = turning(attitude=Rotation.from_rotvec(np.outer(angle, [1, 0, 0])).as_quat())
    assert (EFFECT.obstacle(covariates) is None) == is_enough
