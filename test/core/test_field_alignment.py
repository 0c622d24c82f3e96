"""How a recorded attitude is turned against the frame of a field."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.core.field_alignment import aligned, find_turn, likely_turn
from tam_calibration.model.exceptions import InputError


def test_of_an_array_that_hardly_turned_the_mount_is_near_to_none():
    """At rest, about one axis, and of one sample; turned about two it is what the readings say, here 120°."""
    rng = np.random.default_rng(6)
    mount = Rotation.from_rotvec(np.radians(120) / np.sqrt(3) * np.ones(3)).as_matrix()
    field = np.array([0.1, 0.4, -0.9])
    for turns in (np.zeros((50, 1)), np.linspace(0, 2, 50)[:, None], np.zeros((1, 1))):
        attitude = Rotation.from_euler("z", turns)
        likely = likely_turn(attitude.inv().apply(field), attitude.as_matrix())
        assert_allclose(likely, np.eye(3), atol=1e-6)
        with pytest.raises(InputError, match="about two axes"):
            find_turn(attitude.inv().apply(field), attitude.as_matrix())
    attitude = Rotation.random(50, rng)
    seen = attitude.inv().apply(field)
    assert_allclose(likely_turn(seen @ mount, attitude.as_matrix()), mount, atol=1e-9)


def test_an_aligned_attitude_keeps_the_field_still():
    """Mounted askew and noisy, it then turns the field into one direction; without errors it stays as it was."""
    rng = np.random.default_rng(7)
    attitude, world = Rotation.random(200, rng), np.array([0.1, 0.4, -0.9])
    field = attitude.inv().apply(world)
    assert_allclose((Rotation.from_quat(aligned(attitude.as_quat(), field)) * attitude.inv()).magnitude(), 0, atol=1e-9)
    noisy = attitude * Rotation.from_rotvec(rng.normal(scale=0.02, size=(200, 3))) * Rotation.from_rotvec([0.5, 0, 0.3])
    along = Rotation.from_quat(aligned(noisy.as_quat(), field)).apply(field)
    assert_allclose(along, np.broadcast_to(along[0], along.shape), atol=1e-9)
    assert_allclose(along[0], world, atol=0.01)
