"""A reading that is a curve of the field."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.curves import Hysteresis, Nonlinearity
from tam_calibration.model.sensor_errors import SensorErrors

EFFECT = Nonlinearity()
SHAPE = {"full_scale_T": 50e-6}


def test_a_power_of_the_field_is_within_the_terms(turning):
    """s⁵ is a sum of the curves, an offset and a scale factor."""
    covariates = turning()
    sensed = covariates.sensed_T[:, 4] / 50e-6
    own = [term.features for term in EFFECT.terms(covariates, SHAPE) if (term.sensor, term.axis) == (1, 1)]
    basis = np.column_stack([np.ones_like(sensed), sensed, *own])
    left = sensed**5 - basis @ np.linalg.lstsq(basis, sensed**5, rcond=None)[0]
    assert_allclose(left, 0, atol=1e-12)


def test_small_turns_show_nothing(turning):
    """Within some degrees every curve is straight."""
    still = turning(attitude=np.tile([0.1, 0.2, 0.3, 0.9], (1200, 1)) + 1e-3 * np.eye(4)[np.arange(1200) % 4])
    assert "no axis sees the field change" in EFFECT.obstacle(still)
    assert EFFECT.obstacle(turning()) is None


@pytest.mark.parametrize("effect", [Nonlinearity(), Hysteresis()], ids=lambda effect: effect.name)
@pytest.mark.parametrize(("turn", "is_enough"), [(0.07, False), (0.14, True)])
def test_an_axis_must_see_the_field_change_by_a_tenth(turning, effect, turn, is_enough):
    """Of its length, to and fro."""
    covariates = turning()
    angle = turn / 2 * np.sin(covariates.time_s)
    field = 50e-6 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    errors = SensorErrors.none(4)
    assert (effect.obstacle(replace(covariates, field_T=field, errors=errors)) is None) == is_enough
