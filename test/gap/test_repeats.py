"""Poses that are taken up again."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.gap.laws.find import near_repeats, repeats
from tam_calibration.gap.laws.whitened import residual_of


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


def test_a_motion_that_comes_back_tells_functions_of_direction_from_courses_in_time(run):
    """Curves of the direction are the same at both times; a drift, and a gain that is on for half of it, are not."""
    residual = residual_of(run(samples=900).model())
    again = near_repeats(residual)
    direction, time_s = residual.field, residual.time_s
    assert again.are_same(direction**2)
    assert not again.are_same(time_s[:, None])
    assert not again.are_same(direction * (np.sin(2 * np.pi * time_s / 13) > 0)[:, None])


def test_a_motion_that_does_not_come_back_tells_nothing(run):
    """Half a turn about one axis has each direction once."""
    angle = np.linspace(0, np.pi, 900)
    turning = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    assert near_repeats(replace(residual_of(run(samples=900).model()), field=turning)) is None
