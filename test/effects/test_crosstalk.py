"""Channels that bleed into each other."""

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.effects.crosstalk import Crosstalk
from tam_calibration.effects.fitted import Contribution, FittedEffect
from tam_calibration.files.effects_schema import EffectFile, effect_to_mapping

EFFECT = Crosstalk()


def test_coefficients_come_back(turning, refitted):
    """What bleeds into some axes is told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), {}, (0, 0, "previous 2 y"), (2, 1, "previous 2 z"))
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


def test_the_reading_before_is_what_a_multiplexer_held(turning):
    """A capacitor that keeps a part of the reading before adds that, less the same part of the present one."""
    situation = turning()
    other = situation.sensed_T[:, 4] + situation.errors.bias_T[1, 1]
    held = np.empty(1200)
    held[0], held[1:] = other[0], other[:-1]
    fitted = FittedEffect("crosstalk", {}, (Contribution(0, 2, "previous 2 y", {"bleed": 0.01}),))
    added = EFFECT.signal(situation, fitted)
    assert_allclose(added[:, 2], 0.01 * (held - other), atol=1e-18)
    assert not np.delete(added, 2, axis=1).any()


def test_nothing_is_held_across_a_hole(turning):
    """The reading before a hole is not the one before."""
    whole = turning()
    broken = whole.take(np.r_[0:400, 600:1200])
    ours, theirs = (EFFECT.terms(situation, {})[0].features[:, 0] for situation in (broken, whole))
    assert ours[400] == 0
    assert_allclose(np.delete(ours, 400), np.delete(theirs[np.r_[0:400, 600:1200]], 400))


def test_parallel_axes_are_left_out(turning):
    """What they bleed is a delay or a gain of the axis itself."""
    names = {(term.sensor, term.axis, term.name) for term in EFFECT.terms(turning(), {})}
    assert len(names) == 12 * 8
    assert (0, 0, "previous 2 y") in names and (0, 0, "previous 2 x") not in names


def test_poses_show_nothing(turning):
    """Without motion there is no reading before that differs."""
    poses = turning(samples=300, attitude=np.random.default_rng(1).normal(size=(300, 4)))
    assert "jumps" in EFFECT.obstacle(poses)
    assert "too few" in EFFECT.obstacle(turning(samples=10))
    assert EFFECT.obstacle(turning()) is None


def test_it_survives_a_file():
    """Read again from what is written, it is the same."""
    fitted = FittedEffect("crosstalk", {}, (Contribution(1, 2, "previous 2 x", {"bleed": 2e-4}),))
    assert EffectFile.model_validate(effect_to_mapping(fitted, {"bleed": "1"})).to_fitted() == fitted
