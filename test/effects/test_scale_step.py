"""Steps of a sensor's response."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.states import ScaleStep
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

EFFECT = ScaleStep()
STEP = {"time_s": 31.42}


def test_a_turn_is_that_of_the_sensor(turning):
    """What a small turn adds after its time is the reading of the turned field less that of the field."""
    covariates = turning()
    turn = np.array([3e-6, -1e-6, 2e-6])
    values = {f"turn about {axis}": value for axis, value in zip("xyz", turn, strict=True)}
    added = EFFECT.signal(covariates, FittedEffect("scale_step", STEP, (Contribution(2, None, "turn", values),)))
    turned = Rotation.from_rotvec(turn).apply(covariates.field_T) - covariates.field_T
    expected = np.zeros_like(added)
    expected[:, 6:9] = (turned @ covariates.errors.matrix[2].T) * (covariates.time_s > 31.42)[:, None]
    assert_allclose(added, expected, atol=1e-5 * np.abs(expected).max())
