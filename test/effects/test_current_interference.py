"""The field of a current."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.courses import CurrentInterference
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect

SHAPE = {"reference_A": 0.5, "time_constant_s": 0.3}
EFFECT = CurrentInterference()


def test_the_scalar_sees_the_part_along_the_field(turning):
    """A small field changes the length of the sum as the scalar row says."""
    covariates = turning()
    added = np.array([3e-9, -2e-9, 1e-9])
    values = dict(zip(("field x", "field y", "field z"), added, strict=True))
    fitted = FittedEffect(EFFECT.name, {"reference_A": 0.0}, (Contribution(SCALAR, None, "field", values),))
    total = covariates.field_T + np.outer(covariates.current_A, added)
    longer = np.linalg.norm(total, axis=1) - covariates.intensity_T
    assert_allclose(EFFECT.signal(covariates, fitted)[:, -1], longer, atol=1e-12)


def test_a_constant_current_shows_nothing(turning):
    """A supply that varies by some thousandths is constant; switched for a short while it is not."""
    covariates = turning()
    ripple = 10 + 0.005 * np.random.default_rng(1).normal(size=covariates.sample_count)
    assert "the current changes by" in EFFECT.obstacle(replace(covariates, current_A=ripple))
    pulse = np.where(np.abs(covariates.time_s - 30) < 2, 1.0, 0.0)
    assert EFFECT.obstacle(replace(covariates, current_A=pulse)) is None


def test_the_field_without_lag_is_tried_first(turning, left_by):
    """Where no lag is needed none is reported."""
    covariates = turning()
    first, *others = EFFECT.shapes(covariates, left_by(EFFECT, covariates, SHAPE))
    assert "time_constant_s" not in first
    assert all("time_constant_s" in shape for shape in others)


@pytest.mark.parametrize(
    ("mean_A", "change_A", "is_enough"),
    [(0.0, 0.0, False), (0.0, 1e-3, True), (10.0, 0.07, False), (10.0, 0.14, True)],
)
def test_a_current_must_change_by_a_hundredth_of_itself(turning, mean_A, change_A, is_enough):
    """What is less is the ripple of a supply."""
    covariates = turning()
    current = mean_A + change_A * (covariates.time_s > 30)
    assert (EFFECT.obstacle(replace(covariates, current_A=current)) is None) == is_enough
