"""Jumps of a bias."""

from numpy.testing import assert_allclose

from tam_calibration.effects.states import BiasJump

EFFECT = BiasJump()
BOX = {"time_s": 31.42, "end_s": 40.07}


def test_it_begins_and_ends_at_its_times(turning):
    """Before and after there is nothing."""
    covariates = turning()
    feature = EFFECT.terms(covariates, BOX)[0].features[:, 0]
    assert_allclose(feature, (covariates.time_s > 31.42) & (covariates.time_s < 40.07))
