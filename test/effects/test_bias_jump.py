"""Jumps of a bias."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.states import BiasJump
from tam_calibration.model.fitted_effect import SCALAR

EFFECT = BiasJump()
STEP = {"time_s": 31.42}
BOX = {"time_s": 31.42, "end_s": 40.07}


@pytest.mark.parametrize("shape", [STEP, BOX])
def test_coefficients_come_back(turning, refitted, shape):
    """Offsets of some axes and of the scalar are told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), shape, (0, 0, "offset"), (2, 1, "offset"), (SCALAR, None, "offset"))
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


def test_it_begins_and_ends_at_its_times(turning):
    """Before and after there is nothing."""
    covariates = turning()
    feature = EFFECT.terms(covariates, BOX)[0].features[:, 0]
    assert_allclose(feature, (covariates.time_s > 31.42) & (covariates.time_s < 40.07))


def test_few_samples_show_nothing(turning):
    """A jump needs a before and an after."""
    assert "too few" in EFFECT.obstacle(turning(samples=10))
