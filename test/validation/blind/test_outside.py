"""The open half of the outside causes."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.validation.blind.case import make_case
from tam_calibration.validation.blind.case_plan import CasePlan
from tam_calibration.validation.blind.continuous_motion import ContinuousMotion
from tam_calibration.validation.blind.disturbance import MOVING
from tam_calibration.validation.blind.outside import OUTSIDE
from tam_calibration.validation.blind.outside_courses import _swung
from tam_calibration.validation.blind.outside_platform import _behind


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("gap", [0.3, 3.0])
def test_every_cause_reaches_its_gap(name, gap):
    """Each is there with the gap asked for, and its key does not say that it is sealed."""
    case = make_case(CasePlan("outside", (name,), (gap,)), 1, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["sealed"] for cause in case.key["effects"]] == [False]


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    followers = ("centrifugal_bias", "gyroscopic_shift", "whipping_boom", "drifting_clock")
    followers += ("slew_limit", "report_on_change", "polled_sensor", "gyro_fusion", "steering_current")
    assert all(OUTSIDE[name].motions == MOVING for name in followers)


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


def test_a_joint_follows_when_its_play_is_used_up():
    """Behind by the play while it moves one way, ahead by it after as much of the other way."""
    angle = np.array([0.0, 0.5, 1.5, 4.0, 3.5, 3.0, 2.0, 2.0, 5.0])
    assert_allclose(_behind(angle, 1.0), [0, 0.5, 1, 1, 0.5, 0, -1, -1, 1])


def test_domain_walls_rest_while_the_field_does(draw):
    """Where the field along a core stays as it is, so does what the walls add."""
    scene = draw(1, motions=("turntable",), with_scalar=False)
    cause = OUTSIDE["barkhausen_noise"].draw(np.random.default_rng(3), scene)
    vectors, _ = cause.change(1.0, (scene.readings_T, scene.intensity_T))
    sensor = cause.sensors[0] - 1
    still = np.diff(scene.readings_T[:, sensor], axis=0) == 0
    assert still.any() and np.abs(np.diff(vectors[:, sensor], axis=0)[still]).max() == 0


def test_the_delays_of_a_clock_are_right_on_the_mean(draw):
    """A constant delay would be another cause."""
    scene, asked = draw(4, motions=("diver",)), []

    def angles(time_s):
        asked.append(time_s)
        return np.zeros((len(time_s), 3))

    noting = replace(scene, motion=ContinuousMotion("diver", angles))
    cause = OUTSIDE["drifting_clock"].draw(np.random.default_rng(4), noting)
    cause.change(0.1, ())
    late_s = noting.time_s - asked[0]
    assert np.mean(late_s) == pytest.approx(0, abs=1e-9) and np.std(late_s) == pytest.approx(0.1)
