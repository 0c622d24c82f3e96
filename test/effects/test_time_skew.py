"""A sensor that is sampled late."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.lags import TimeSkew
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect

EFFECT = TimeSkew()


@pytest.mark.parametrize("delay", [1e-3, -1e-3])
def test_it_is_the_reading_of_a_delay_before(turning, delay):
    """A late sensor reads what it would have read earlier, an early one what it will."""
    finer = turning(samples=60_001, step_s=0.001)
    covariates = finer.take(slice(50, 59_950, 50))
    fitted = FittedEffect(EFFECT.name, {}, (Contribution(1, None, "delay", {"delay": delay}),))
    shift = round(delay / 0.001)
    late = finer.sensed_T[50 - shift : 59_950 - shift : 50] - covariates.sensed_T
    added = EFFECT.signal(covariates, fitted)
    assert_allclose(added[:, 3:6], late[:, 3:6], atol=2e-3 * np.abs(late[:, 3:6]).max())
    assert not added[:, [0, 1, 2, 6, 7, 8, 12]].any()


def test_a_scalar_in_a_constant_field_does_not_show_its_delay(turning):
    """Where the length of the field is constant its delay adds nothing."""
    own = [term for term in EFFECT.terms(turning(), {}) if term.sensor == SCALAR]
    assert_allclose(own[0].features, 0, atol=1e-3 * 50e-6)
