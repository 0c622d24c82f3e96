"""Steps of a sensor's response."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.states import ScaleStep
from tam_calibration.files.schema import check
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

EFFECT = ScaleStep()
STEP = {"time_s": 31.42}
BOX = {"time_s": 31.42, "end_s": 40.07}


@pytest.mark.parametrize("shape", [STEP, BOX])
@pytest.mark.parametrize("keys", [((0, 0, "scale"), (2, 1, "tilt")), ((1, None, "turn"), (3, 2, "scale"))])
def test_coefficients_come_back(turning, refitted, shape, keys):
    """Scales, tilts and turns are told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), shape, *keys)
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.2


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


def test_few_samples_show_nothing(turning):
    """A step needs a before and an after."""
    assert "too few" in EFFECT.obstacle(turning(samples=10))


def test_it_survives_a_file():
    """Read again from what is written, it is the same."""
    fitted = FittedEffect("scale_step", BOX, (Contribution(1, 2, "scale", {"scale": 2e-4}),))
    units = EFFECT.shape_units | {"scale": "1"}
    assert check(effect_to_mapping(fitted, units), EffectFile).to_fitted() == fitted
