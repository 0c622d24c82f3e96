"""Eddy currents."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.lags import EddyCurrent
from tam_calibration.effects.recursions import lagged

EFFECT = EddyCurrent()


@pytest.mark.parametrize("time_constant", [0.01, 0.2, 2.0])
def test_it_is_what_a_lag_has_not_followed(turning, time_constant):
    """At a coarse step it agrees with a lag worked out at a fine one, for time constants below the step too."""
    finer = turning(samples=60_000, step_s=0.001)
    behind = (finer.field_T - lagged(finer.field_T, finer.time_s, time_constant))[::50]
    covariates = finer.take(slice(None, None, 50))
    found = EFFECT.terms(covariates, {"time_constant_s": time_constant})[0].features[:, :3]
    settled = covariates.time_s > 10 * time_constant
    assert_allclose(found[settled], behind[settled], atol=0.03 * np.abs(behind[settled]).max())


def test_a_hole_leaves_no_trace_behind_it(turning):
    """Some time constants after a hole all is as without it."""
    covariates = turning()
    kept = np.r_[0:400, 600:1200]
    shape = {"time_constant_s": 0.2}
    whole, broken = (EFFECT.terms(part, shape)[0].features for part in (covariates, covariates.take(kept)))
    same = np.r_[0:390, 450:1000]
    assert_allclose(broken[same], whole[kept][same], atol=1e-5 * np.abs(whole).max())


def test_time_constants_reach_from_part_of_a_step_to_the_time_of_a_turn(turning, left_by):
    """Few are tried, none so slow that it would be a drift."""
    covariates = turning()
    residuals = left_by(EFFECT, covariates, {"time_constant_s": 1.0})
    tried = [shape["time_constant_s"] for shape in EFFECT.shapes(covariates, residuals)]
    assert tried[0] < 0.05 < 0.5 < tried[-1] < 3
    assert len(tried) <= 8
