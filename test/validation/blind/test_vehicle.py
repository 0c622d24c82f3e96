"""The vehicle of the check: its physics against what is known in closed form, and what a case holds of it."""

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose

from tam_validation.blind.vehicle import Body, driven, platform_field

AXIS = np.array([0.0, 0.6, 0.8])


def test_an_ellipsoid_that_is_nearly_a_sphere_is_magnetised_like_one():
    """By 3 χ / (3 + χ) of the field times the volume, in any direction."""
    body = Body(np.zeros(3), AXIS, 0.5005, 0.5)
    moment = body.magnetised(100.0, 1.0) @ [0, 0, 5e-5]
    expected = 300 / 103 * body.volume_m3 * 5e-5 / (4e-7 * np.pi)
    assert_allclose(moment, [0, 0, expected], rtol=2e-2, atol=2e-2 * expected)


def test_a_needle_is_magnetised_along_itself():
    """Osborn's factors of an ellipsoid ten times as long as wide: 0.0203 along, 0.4899 across."""
    body = Body(np.zeros(3), AXIS, 5.0, 0.5)
    matrix = body.magnetised(1e9, 1.0) / body.volume_m3 * 4e-7 * np.pi
    assert AXIS @ matrix @ AXIS == pytest.approx(1 / 0.0203, rel=2e-3)
    assert matrix[0, 0] == pytest.approx(1 / 0.4899, rel=1e-3)


def test_currents_fade_with_their_time_constant():
    """After one step of what drives them, and follow none that is slow."""
    steps = np.zeros((2000, 3))
    steps[0] = 1.0
    course = driven(steps, 0.001, 0.2)
    assert_allclose(course[201], np.exp(-1), rtol=5e-3)
    ramp = driven(np.full((20_000, 3), 0.001), 0.001, 0.2)
    assert_allclose(ramp[-1], 0.2, rtol=1e-3)


def test_the_scalar_reads_the_length_of_a_vector_sum(draw):
    """A thousand times stronger, its signal is no longer a thousand times as large."""
    scene = draw(3)
    cause = platform_field(np.random.default_rng(3), scene)
    seen = (scene.readings_T, scene.intensity_T)
    (small, of_scalar), (large, of_strong) = cause.change(1.0, seen), cause.change(2000.0, seen)
    assert_allclose(large, 2000 * small, rtol=1e-9)
    assert norm(of_strong - 2000 * of_scalar) > 1e-3 * norm(of_strong)


def test_what_moves_is_recorded(draw):
    """Over many draws rudders and second currents come and go, each with its column."""
    found = set()
    for seed in range(12):
        scene = draw(seed)
        cause = platform_field(np.random.default_rng(seed), scene)
        found.add(tuple(cause.columns))
        assert all(len(values) == scene.sample_count for values in cause.columns.values())
    assert {name for names in found for name in names} == {"actuator_rudder", "current_2_A"}
    assert () in found
