"""Filters that ring."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lsim

from tam_calibration.effects.lags import Ringing
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

EFFECT = Ringing()
SHAPE = {"frequency_hz": 1.3, "damping": 0.2}


@pytest.fixture(scope="module")
def finer(turning):
    """Return a minute at a fine step."""
    return turning(samples=30_000, step_s=0.002)


@pytest.mark.parametrize(
    "shape", [SHAPE, {"frequency_hz": 0.4, "damping": 0.05}, {"frequency_hz": 6.0, "damping": 0.4}]
)
def test_it_is_what_an_oscillator_adds(finer, shape):
    """With the delay of the filter, it is the response of the differential equation at a fine step, less the field."""
    omega, damping = 2 * np.pi * shape["frequency_hz"], shape["damping"]
    start = finer.sensed_T[0, 3:6]
    system = [omega**2], [1, 2 * damping * omega, omega**2]
    passed = np.column_stack([lsim(system, own - own[0], finer.time_s)[1] for own in finer.sensed_T[:, 3:6].T]) + start
    values = {"amplitude": 1.0, "delay": 2 * damping / omega}
    covariates = finer.take(slice(None, None, 25))
    fitted = FittedEffect("ringing", shape, (Contribution(1, None, "response", values),))
    found = EFFECT.signal(covariates, fitted)[:, 3:6]
    expected = (passed - finer.sensed_T[:, 3:6])[::25]
    settled = covariates.time_s > 6 / (damping * omega)
    assert settled.sum() > 200
    assert_allclose(found[settled], expected[settled], atol=0.02 * np.abs(expected[settled]).max())


def test_a_slow_field_shows_no_more_than_its_bend(turning):
    """Gain and delay are taken out: the response to a field that turns slowly is (4 ζ² - 1)/ω² times its bend."""
    covariates = turning(step_s=0.01)
    response = EFFECT.terms(covariates, {"frequency_hz": 20.0, "damping": 0.3})[0].features[:, 0]
    bend = np.gradient(np.gradient(covariates.sensed_T[:, 0], 0.01), 0.01)
    settled = slice(300, -10)
    expected = (4 * 0.3**2 - 1) / (2 * np.pi * 20) ** 2 * bend[settled]
    assert_allclose(response[settled], expected, atol=0.02 * np.abs(expected).max())


def test_a_hole_leaves_no_trace_behind_it(turning):
    """Some periods after a hole all is as without it."""
    covariates = turning()
    kept = np.r_[0:400, 600:1200]
    shape = {"frequency_hz": 3.0, "damping": 0.4}
    whole, broken = (EFFECT.terms(part, shape)[0].features for part in (covariates, covariates.take(kept)))
    same = np.r_[0:390, 500:1000]
    assert_allclose(broken[same], whole[kept][same], atol=1e-4 * np.abs(whole).max())


def test_frequencies_reach_from_the_motion_to_half_the_sampling_rate(turning, left_by):
    """Few are tried."""
    covariates = turning()
    every = list(EFFECT.shapes(covariates, left_by(EFFECT, covariates, SHAPE)))
    tried = [shape for shape in every if "frequency_hz" in shape]
    assert len(every) == 20
    frequencies = sorted({shape["frequency_hz"] for shape in tried})
    motion = (
        np.sqrt(np.mean(np.gradient(covariates.field_T, 0.05, axis=0) ** 2)) / np.std(covariates.field_T, axis=0).max()
    )
    assert 1.2 < 2 * np.pi * frequencies[0] / motion < 3 and frequencies[-1] == pytest.approx(10)
    assert len(tried) == 10
    assert all(0 < shape["damping"] < 1 for shape in tried)


def test_each_jump_from_pose_to_pose_has_a_tail(turning, refitted):
    """An oscillation that dies, of any phase, is told from the calibration; where poses jump nothing else is sought."""
    covariates = turning(samples=1200, attitude=np.repeat(np.random.default_rng(1).normal(size=(60, 4)), 20, axis=0))
    shape = {"tail_hz": 4.0, "damping": 0.15}
    jump = np.diff(covariates.sensed_T[:, 4], prepend=covariates.sensed_T[0, 4])
    turn = 2 * np.pi * 4.0 * covariates.step_s
    dying = np.array([np.exp(-0.15 * turn * n) * np.cos(turn * np.sqrt(1 - 0.15**2) * n) for n in range(1200)])
    part = Contribution(1, 1, "response of the axis", {"tail": 0.01})
    added = EFFECT.signal(covariates, FittedEffect("ringing", shape, (part,)))
    assert_allclose(added[:, 4], 0.01 * np.convolve(jump, dying)[:1200], atol=1e-15)
    deviation, _ = refitted(EFFECT, covariates, shape, (1, 1, "response of the axis"))
    assert np.abs(deviation).max() < 4
    assert all("tail_hz" in tried for tried in EFFECT.shapes(covariates, None))


def test_a_tail_ends_before_the_next_jump(turning, left_by):
    """The slowest that is tried turns once in some sixteen samples."""
    covariates = turning(samples=300, attitude=np.random.default_rng(1).normal(size=(300, 4)))
    tried = [shape["tail_hz"] for shape in EFFECT.shapes(covariates, left_by(EFFECT, covariates, SHAPE))]
    assert 12 < 1 / (min(tried) * covariates.step_s) < 24
