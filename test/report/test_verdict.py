from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit.coverage import measure_coverage
from tam_calibration.model.array import Array
from tam_calibration.model.residuals import Residuals
from tam_calibration.report.formatting import number
from tam_calibration.report.verdict import judge

ALL_ROUND = measure_coverage(np.random.default_rng(1).normal(size=(4000, 3)))
NARROW = measure_coverage(np.random.default_rng(1).normal([0, 0, 1], 0.05, (4000, 3)))


def scaled(residuals: Residuals, factor: float) -> Residuals:
    """Return larger residuals."""
    return Residuals(
        factor * residuals.sensor_intensity_T,
        factor * residuals.center_intensity_T,
        factor * residuals.tensor_T_per_m,
    )


def test_good_calibration_can_be_used(make):
    """The sentence gives error before, after and against the floor, and ends in the judgement."""
    calibration, _ = make()
    verdict = judge(calibration, ALL_ROUND)
    before = number(1e9 * calibration.before.tensor_rmse_T_per_m)
    after = number(1e9 * calibration.held_out.tensor_rmse_T_per_m)
    assert verdict.sentence.startswith(f"Tensor error falls from {before} to {after} nT/m, ")
    assert verdict.sentence.endswith("× the noise floor; the calibration can be used.")
    assert not verdict.doubts
    assert not verdict.limits


def test_residual_above_floor_is_doubted(make):
    """A residual of twice the floor is doubted, and the sensors are named."""
    calibration, _ = make()
    verdict = judge(replace(calibration, held_out=scaled(calibration.floor, 2)), ALL_ROUND)
    assert "2.00 × the noise floor; the calibration should be doubted: its residual" in verdict.sentence
    assert "|B| of sensor 4 (2.00 ×) and the tensor (2.00 ×)" in verdict.doubts[0].detail


def test_common_mode_residual_is_doubted_although_the_tensor_is_clean(make):
    """What all sensors share is invisible in the tensor, not in |B|."""
    calibration, _ = make()
    held_out = replace(calibration.held_out, sensor_intensity_T=3 * calibration.floor.sensor_intensity_T)
    verdict = judge(replace(calibration, held_out=held_out), ALL_ROUND)
    assert [doubt.reason for doubt in verdict.doubts] == ["its residual is above the noise floor"]
    assert "tensor" not in verdict.doubts[0].detail


def test_held_out_residuals_are_what_counts(make):
    """A fit that is good only on its own samples is doubted."""
    calibration, _ = make()
    assert judge(replace(calibration, held_out=scaled(calibration.in_sample, 5)), ALL_ROUND).doubts


def test_low_coverage_is_doubted_with_advice(make):
    """The reason says what is missing and what to do next."""
    calibration, _ = make()
    (doubt,) = judge(calibration, NARROW).doubts
    assert doubt.reason == "its coverage of the sphere is too low"
    assert NARROW.advice[1:] in doubt.detail


@pytest.mark.parametrize(("bias_error_T", "doubted"), [(0.05e-9, False), (5e-9, True)])
def test_large_standard_errors_are_doubted(make, bias_error_T, doubted):
    """Standard errors count against the noise of a corrected sample."""
    covariance = np.zeros((48, 48))
    covariance[6, 6] = bias_error_T**2
    calibration, _ = make(covariance=covariance)
    assert bool(judge(calibration, ALL_ROUND).doubts) == doubted


def test_warnings_of_the_fit_are_doubts(make):
    """What the fit warned of is passed on."""
    calibration, _ = make(warnings=("something magnetic came near",))
    (doubt,) = judge(calibration, ALL_ROUND).doubts
    assert "something magnetic came near" in doubt.detail


def test_limits_are_said(make):
    """What is missing limits the verdict without making the calibration bad."""
    calibration, _ = make(scalar=False, covariance=None, held_out=None, noise_is_estimated=True)
    verdict = judge(calibration, ALL_ROUND)
    assert not verdict.doubts
    assert "can be used but for its absolute scale" in verdict.sentence
    assert "which was estimated from the same recording" in verdict.sentence
    assert [limit.split()[2] for limit in verdict.limits] == ["no", "gives", "were", "noise"]


def test_one_sensor_is_judged_by_its_intensity(make):
    """Without a gradient the sentence speaks of |B|."""
    calibration, _ = make(Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10))
    assert judge(calibration, ALL_ROUND).sentence.startswith("|B| error falls from ")


def test_worse_after_than_before_is_said(make):
    """An error that grows is not said to fall."""
    calibration, _ = make()
    verdict = judge(replace(calibration, held_out=scaled(calibration.before, 2)), ALL_ROUND)
    assert "Tensor error rises from" in verdict.sentence
