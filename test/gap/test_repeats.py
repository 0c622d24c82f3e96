"""Poses that are taken up again."""

import numpy as np
import pytest

from tam_calibration.gap.laws.find import repeats


def poses(order):
    """Return unit vectors (N, 3) of twenty poses in an order."""
    drawn = np.random.default_rng(1).normal(size=(20, 3))
    return (drawn / np.linalg.norm(drawn, axis=1)[:, None])[order]


@pytest.mark.parametrize("order", [np.tile(np.arange(20), 2), np.append(np.arange(20), np.arange(20)[::-1])])
def test_a_function_of_the_pose_is_the_same_at_both_visits_and_a_step_is_not(order):
    """Poses twice over, and there and back; what is the same keeps its energy in the product of the visits."""
    pose = poses(order)
    again = repeats(pose)
    assert again.are_same(pose[:, :1] ** 3)
    assert not again.are_same((np.arange(40)[:, None] > 25).astype(float))
    noise = np.random.default_rng(2).normal(size=(40, 1))
    assert again.energy(3 * pose[:, :1] + 0.1 * noise) == pytest.approx(np.mean((3 * pose[:, 0]) ** 2), rel=0.3)


@pytest.mark.parametrize("order", [np.arange(20), np.repeat(np.arange(20), 5), np.zeros(40, dtype=int)])
def test_poses_that_are_held_are_not_taken_up_again(order):
    """Once each, held for five samples, or one pose throughout."""
    assert repeats(poses(order)) is None
