"""Jumps of a bias."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.bias_jump import BiasJump
from tam_calibration.effects.fitted import SCALAR

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
    situation = turning()
    feature = EFFECT.terms(situation, BOX)[0].features[:, 0]
    assert_allclose(feature, (situation.time_s > 31.42) & (situation.time_s < 40.07))


@pytest.mark.parametrize("where", [(1, 2), (SCALAR, None)])
@pytest.mark.parametrize("shape", [STEP, BOX])
def test_a_jump_of_one_row_is_found_to_the_sample(turning, left_by, where, shape):
    """Among the few shapes that are tried is the true one."""
    situation = turning()
    misfit = left_by(EFFECT, situation, shape, (*where, "offset", {"offset": 6e-9}))
    tried = EFFECT.shapes(situation, misfit)
    assert len(tried) <= 8
    distance = [
        max(abs(other[name] - shape[name]) for name in shape) for other in tried if other.keys() == shape.keys()
    ]
    assert min(distance) <= 0.05


def test_a_magnet_that_all_sensors_see_is_found(turning, left_by):
    """Small jumps in many rows add up."""
    situation = turning()
    offsets = 1.5e-9 * np.random.default_rng(3).choice([-1, 1], 12)
    jumps = [(*divmod(row, 3), "offset", {"offset": float(offset)}) for row, offset in enumerate(offsets)]
    tried = EFFECT.shapes(situation, left_by(EFFECT, situation, BOX, *jumps))
    pairs = [shape for shape in tried if "end_s" in shape]
    assert min(max(abs(pair[name] - BOX[name]) for name in BOX) for pair in pairs) <= 0.1


def test_a_sensor_of_its_own_can_jump(turning, left_by):
    """One sensor and a scalar are enough."""
    situation = turning(sensors=1)
    tried = EFFECT.shapes(situation, left_by(EFFECT, situation, STEP, (0, 0, "offset", {"offset": 10e-9})))
    assert min(abs(shape["time_s"] - 31.42) for shape in tried) <= 0.2


def test_what_lags_behind_the_fastest_change_is_no_step(turning, left_by, slew):
    """An amplifier too slow for five samples of a run leaves no change for good or for a time."""
    situation = turning()
    tried = list(EFFECT.shapes(situation, left_by(slew, situation, {}, (1, 0, "offset", {"offset": 1.0}))))
    fastest = situation.time_s[np.argmax(np.abs(np.diff(situation.sensed_T[:, 3])))]
    assert all(abs(time - fastest) > 0.5 for shape in tried for time in shape.values())


def test_few_samples_show_nothing(turning, left_by):
    """A jump needs a before and an after."""
    situation = turning(samples=10)
    assert "too few" in EFFECT.obstacle(situation)
    assert list(EFFECT.shapes(situation, left_by(EFFECT, situation, STEP))) == []
