"""Channels that bleed into each other."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.crosstalk import Crosstalk
from tam_calibration.effects.fitted import Contribution, FittedEffect
from tam_calibration.files.effects_schema import EffectFile, effect_to_mapping

EFFECT = Crosstalk()
WINDOWS = {"on_1_s": 5.02, "off_1_s": 8.02, "on_2_s": 21.52, "off_2_s": 25.02, "on_3_s": 50.02}


@pytest.mark.parametrize(("shape", "name"), [({}, "previous"), (WINDOWS, "busy")])
def test_coefficients_come_back(turning, refitted, shape, name):
    """What bleeds into some axes is told from the calibration."""
    deviation, error = refitted(EFFECT, turning(), shape, (0, 0, f"{name} 2 y"), (2, 1, f"{name} 2 z"))
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


def test_busy_windows_are_found(turning, left_by):
    """Windows in which another axis bleeds in are offered beside the reading before."""
    situation = turning()
    tried = EFFECT.shapes(situation, left_by(EFFECT, situation, WINDOWS, (1, 2, "busy 3 x", {"bleed": 3e-4})))
    none, found = tried
    assert none == {} and found.keys() == WINDOWS.keys()
    assert max(abs(found[name] - WINDOWS[name]) for name in WINDOWS) < 0.3


def test_noise_offers_no_windows_and_poses_no_reading_before(turning, left_by):
    """Where nothing comes and goes, and nothing moves, there is nothing to try."""
    situation = turning()
    nothing = (1, 2, "busy 3 x", {"bleed": 0.0})
    assert list(EFFECT.shapes(situation, left_by(EFFECT, situation, WINDOWS, nothing))) == [{}]
    poses = turning(samples=300, attitude=np.random.default_rng(1).normal(size=(300, 4)))
    assert list(EFFECT.shapes(poses, left_by(EFFECT, poses, WINDOWS, nothing))) == []


def test_few_samples_show_nothing(turning, left_by):
    """Channels that hardly change are all alike."""
    situation = turning(samples=10)
    assert "too few" in EFFECT.obstacle(situation)
    assert list(EFFECT.shapes(situation, left_by(EFFECT, situation, {}))) == []


@pytest.mark.parametrize(("shape", "name"), [({}, "previous 2 x"), (WINDOWS, "busy 2 x")])
def test_it_survives_a_file(shape, name):
    """Read again from what is written, it is the same."""
    fitted = FittedEffect("crosstalk", shape, (Contribution(1, 2, name, {"bleed": 2e-4}),))
    units = dict(EFFECT.shape_units) | {"bleed": "1"}
    assert EffectFile.model_validate(effect_to_mapping(fitted, units)).to_fitted() == fitted
