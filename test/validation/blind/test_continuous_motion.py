import numpy as np
from numpy.testing import assert_allclose

from tam_validation.blind.continuous_motion import ContinuousMotion, about, draw_motion


def test_attitudes_are_rotations(motion):
    """Every attitude is orthogonal and right-handed."""
    turns = draw_motion(np.random.default_rng(1), motion, 100.0, 500).to_world(np.linspace(0, 100, 500))
    assert_allclose(turns @ np.swapaxes(turns, 1, 2), np.tile(np.eye(3), (500, 1, 1)), atol=1e-12)
    assert_allclose(np.linalg.det(turns), 1)


def test_turning_rate_of_a_steady_turn():
    """A steady turn about the vertical has its rate on the vertical axis."""
    steady = ContinuousMotion("steady", lambda time_s: np.stack([0.3 * time_s, 0 * time_s, 0 * time_s], axis=1))
    assert_allclose(steady.turning_rate(np.linspace(0, 9, 10), 1e-3), np.tile([0, 0, 0.3], (10, 1)), atol=1e-6)


def test_right_hand():
    """A quarter turn about z brings x to y."""
    assert_allclose(about("z", np.array([np.pi / 2]))[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)


def test_the_turntable_takes_poses_up_again():
    """Of thirty turntables some go through half of their poses twice, and some rest in one for a fifth of the run."""
    again, longest = [], []
    for seed in range(30):
        motion = draw_motion(np.random.default_rng(seed), "turntable", 300.0, 1200)
        angles = motion.angles(np.arange(1200) / 4)
        moved = np.flatnonzero(np.abs(np.diff(angles, axis=0)).sum(axis=1) > 0)
        visits = angles[np.append(moved, 1199)]
        again.append(len(visits) / len(np.unique(visits, axis=0)))
        longest.append(np.diff(moved).max())
    assert sum(one > 1.8 for one in again) >= 8
    assert sum(one >= 200 for one in longest) >= 3


def test_a_pose_on_the_turntable_is_held():
    """On the turntable consecutive samples repeat a pose or jump; none lies between two poses."""
    motion = draw_motion(np.random.default_rng(5), "turntable", 300.0, 1200)
    fine = motion.angles(np.linspace(0, 300, 50000))
    assert len(np.unique(fine, axis=0)) <= 1200
