"""The causes outside the library."""

from dataclasses import replace

import numpy as np
import pytest

from tam_validation.blind.continuous_motion import ContinuousMotion
from tam_validation.blind.disturbance import MOVING
from tam_validation.blind.outside import OUTSIDE


def test_what_follows_the_rate_is_drawn_in_motion_only():
    """A turntable, which stands still while a sample is taken, shows no rate."""
    assert {name for name, cause in OUTSIDE.items() if cause.motions == MOVING} == {
        "centrifugal_bias",
        "gyroscopic_shift",
        "polled_sensor",
    }


def test_a_shift_by_rotation_follows_the_rate_about_the_field(draw):
    """The scalar errs by the rotation about the field, of either sign."""
    scene = draw(1)
    _, scalar = OUTSIDE["gyroscopic_shift"].draw(np.random.default_rng(1), scene).change(1.0, ())
    rate = scene.motion.turning_rate(scene.time_s, 1e-3)
    about = (rate * scene.field_T).sum(axis=1) / scene.intensity_T
    assert abs(np.corrcoef(scalar, about)[0, 1]) > 0.9


def test_what_slips_keeps_the_length_of_the_reading(change_of):
    """The error lies across the field, and steps twice."""
    scene, cause, change = change_of("mount_slip", 1)
    along = (change * scene.core(cause.sensors[0] - 1)).sum(axis=1)
    assert np.abs(along).max() < 1e-12 * np.abs(change).max()


def test_warmth_follows_its_side_slowly(change_of):
    """From one sample to the next the bias changes by a small part of all that it does."""
    _, _, change = change_of("sunlit_side", 1)
    assert np.abs(np.diff(change, axis=0)).max() < 0.2 * np.ptp(change)


def test_the_ages_of_polled_readings_are_right_on_the_mean(draw):
    """A constant delay would be another cause."""
    scene, asked = draw(4, motions=("diver",)), []

    def angles(time_s):
        asked.append(time_s)
        return np.zeros((len(time_s), 3))

    noting = replace(scene, motion=ContinuousMotion("diver", angles))
    cause = OUTSIDE["polled_sensor"].draw(np.random.default_rng(4), noting)
    cause.change(0.1, ())
    late_s = noting.time_s - asked[0]
    assert np.mean(late_s) == pytest.approx(0, abs=0.02) and np.std(late_s) == pytest.approx(0.1, rel=0.1)
