"""The open half of the outside causes."""

import numpy as np
import pytest

from tam_calibration.blind.case import make_case
from tam_calibration.blind.entry import MOVING
from tam_calibration.blind.outside import OUTSIDE
from tam_calibration.blind.outside_motion import _swung
from tam_calibration.blind.plan import Plan


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("gap", [0.3, 3.0])
def test_every_cause_reaches_its_gap(name, gap):
    """Each is there with the gap asked for, and its key does not say that it is sealed."""
    case = make_case(Plan("outside", (name,), (gap,)), 1, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["sealed"] for cause in case.key["effects"]] == [False]


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    assert OUTSIDE["centrifugal_bias"].motions == OUTSIDE["gyroscopic_shift"].motions == MOVING


def test_a_shift_by_rotation_follows_the_rate_about_the_field(draw):
    """The scalar errs by the rotation about the field, of either sign."""
    scene = draw(1)
    _, scalar = OUTSIDE["gyroscopic_shift"].draw(np.random.default_rng(1), scene).change(1.0, ())
    rate = scene.motion.turning_rate(scene.time_s, 1e-3)
    about = (rate * scene.field_T).sum(axis=1) / scene.intensity_T
    assert abs(np.corrcoef(scalar, about)[0, 1]) > 0.9


def test_a_pendulum_swings_at_its_own_period():
    """After a step it passes the new rest after a quarter of its period, overshoots, and comes to rest there."""
    drive = np.zeros((400, 3))
    drive[1:, 0] = 1
    path = _swung(drive, 2 * np.pi / 20, 0.1)[:, 0]
    assert 5 <= np.argmax(path > 1) <= 8 and path.max() > 1.5
    assert path[-1] == pytest.approx(1, abs=1e-3)
