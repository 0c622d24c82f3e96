"""Attitudes over time."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.model.exceptions import InputError
from tam_calibration.simulation.conditions import (
    Manoeuvre,
    RandomAttitudes,
    RandomEulerAngles,
    ThreeAxisTurns,
    Tumble,
    Turntable,
)

MOTIONS = [
    RandomAttitudes(),
    RandomEulerAngles(),
    ThreeAxisTurns(),
    Turntable(),
    Tumble(),
    Manoeuvre(np.radians(30), np.radians(20), 60.0),
]


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("count", [1, 2, 100])
def test_every_motion_gives_unit_quaternions(motion, count):
    """Each sample has one quaternion of length 1."""
    quaternions = motion.attitudes(np.arange(count) / 10, np.random.default_rng(1))
    assert quaternions.shape == (count, 4)
    assert_allclose(np.linalg.norm(quaternions, axis=1), 1, rtol=1e-12)


def test_random_attitudes_prefer_no_direction():
    """A fixed direction seen from uniformly random attitudes has the mean 0 and the covariance 1/3."""
    count = 20_000
    quaternions = RandomAttitudes().attitudes(np.arange(count), np.random.default_rng(2))
    seen = Rotation.from_quat(quaternions).inv().apply([0.0, 0.6, -0.8])
    assert_allclose(seen.mean(axis=0), 0, atol=4 / np.sqrt(3 * count))
    assert_allclose(np.cov(seen.T), np.eye(3) / 3, atol=0.01)


def test_three_axis_turns_close_about_each_axis():
    """A third of the samples turns about each axis, in equal steps that close the circle."""
    quaternions = ThreeAxisTurns().attitudes(np.arange(36), np.random.default_rng(0))
    for axis, part in enumerate(Rotation.from_quat(quaternions).as_rotvec().reshape(3, 12, 3)):
        angle = np.degrees(part[:, axis]) % 360
        assert_allclose(angle, np.arange(12) * 30, atol=1e-9)
        assert_allclose(np.delete(part, axis, axis=1), 0, atol=1e-12)


def test_turntable_has_72_distinct_poses():
    """No two of Wu's poses are the same rotation."""
    poses = Rotation.from_quat(Turntable().attitudes(np.arange(72), np.random.default_rng(0)))
    between = [(pose.inv() * poses).magnitude() for pose in poses]
    assert np.min(np.array(between) + 10 * np.eye(72)) > np.radians(25)


def test_turntable_starts_as_published_and_repeats():
    """The first pose is -90° about z alone; after 72 poses they come again."""
    quaternions = Turntable().attitudes(np.arange(144), np.random.default_rng(0))
    assert_allclose(Rotation.from_quat(quaternions[0]).as_euler("xyz", degrees=True), [0, 0, -90], atol=1e-9)
    assert_allclose(quaternions[72:], quaternions[:72])


def test_tumble_is_smooth():
    """Between samples the tumble turns by no more than the sum of its rates, and steadily."""
    time = np.arange(4000) / 100
    poses = Rotation.from_quat(Tumble(np.radians(90)).attitudes(time, np.random.default_rng(0)))
    step = (poses[:-1].inv() * poses[1:]).as_rotvec(degrees=True) * 100
    assert np.linalg.norm(step, axis=1).max() < 90 * (1 + 0.618 + 0.382)
    assert np.linalg.norm(np.diff(step, axis=0) * 100, axis=1).max() < 2 * 90**2 * np.pi / 180


@given(pitch=st.floats(0, 89), roll=st.floats(0, 89), period=st.floats(1, 1000), count=st.integers(1, 200))
def test_manoeuvre_keeps_its_limits(pitch, roll, period, count):
    """Pitch and roll never exceed their limits, whatever the period."""
    motion = Manoeuvre(np.radians(pitch), np.radians(roll), period)
    quaternions = motion.attitudes(np.arange(count) / 2, np.random.default_rng(0))
    angles = Rotation.from_quat(quaternions).as_euler("ZYX", degrees=True)
    assert np.abs(angles[:, 1]).max() <= pitch + 1e-6
    assert np.abs(angles[:, 2]).max() <= roll + 1e-6


def test_manoeuvre_visits_all_headings_and_its_limits():
    """In a few circles every heading is taken, and pitch and roll come within a degree of their limits."""
    motion = Manoeuvre(np.radians(30), np.radians(20), 60.0)
    quaternions = motion.attitudes(np.arange(0, 300, 0.1), np.random.default_rng(0))
    yaw, pitch, roll = Rotation.from_quat(quaternions).as_euler("ZYX", degrees=True).T
    assert len(np.unique(np.floor(yaw / 10))) == 36
    assert pitch.max() > 29 and pitch.min() < -29
    assert roll.max() > 19 and roll.min() < -19


@pytest.mark.parametrize("limits", [(90, 10), (10, 90), (-1, 10), (np.nan, 10)])
def test_manoeuvre_refuses_limits_beyond_the_vertical(limits):
    """Yaw has no meaning at ±90° of pitch."""
    with pytest.raises(InputError, match="less than 90 degrees"):
        Manoeuvre(*np.radians(limits), 60.0)


def test_manoeuvre_refuses_a_period_that_is_not_positive():
    """A circle takes time."""
    with pytest.raises(InputError, match="positive number of seconds, not 0"):
        Manoeuvre(0.1, 0.1, 0)


def test_random_motions_repeat_with_the_seed():
    """The same generator gives the same attitudes, another one others."""
    for motion in (RandomAttitudes(), RandomEulerAngles()):
        first, again, other = (motion.attitudes(np.arange(5), np.random.default_rng(seed)) for seed in (1, 1, 2))
        assert_allclose(first, again, rtol=0)
        assert not np.allclose(first, other)
