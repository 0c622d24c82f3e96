import magpylib
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.sources.dipole import Loop, area_of, dipole_field, loop_field

RADIUS = 0.445


@pytest.mark.parametrize("distance", [0.02, 0.3, 1, 3, 30])
def test_field_is_that_of_magpylib(distance):
    """Inside the loop, near it and far away, tilted and moved."""
    turn, place = Rotation.from_rotvec([0.5, -0.8, 0.3]), np.array([2.4, -1.0, 0.46])
    points = place + distance * np.random.default_rng(4).normal(size=(50, 3))
    coil = magpylib.current.Circle(position=place, orientation=turn, diameter=2 * RADIUS, current=708)
    loop = Loop(place, turn.apply([0, 0, 708 * area_of(RADIUS)]), RADIUS)
    expected = coil.getB(points)
    assert_allclose(loop.field_T(points), expected, atol=1e-8 * np.abs(expected).max())
    assert loop.current_A == pytest.approx(708)


@pytest.mark.parametrize("distance", [0.05, 0.3, 1, 3, 30])
def test_gradient_and_derivative_by_the_moment_are_slopes_of_the_field(slope, distance):
    """Central differences agree at all places, on the axis and in the plane of the loop too."""
    moment = np.array([100.0, -300.0, 200.0])
    axis = moment / np.linalg.norm(moment)
    across = np.cross(axis, [1, 0, 0])
    drawn = np.random.default_rng(4).normal(size=(10, 3))
    places = np.vstack([drawn, axis, 1.7 * across / np.linalg.norm(across)]) * distance
    _, gradient, by_moment = loop_field(places, moment, RADIUS)
    for n, place in enumerate(places):
        by_place = slope(lambda point: loop_field(point, moment, RADIUS)[0], place, 2e-3 * max(distance, RADIUS))
        by_value = slope(lambda value, place=place: loop_field(place, value, RADIUS)[0], moment, 0.5)
        assert_allclose(gradient[n], by_place, atol=3e-8 * np.abs(by_place).max())
        assert_allclose(by_moment[n], by_value, atol=3e-8 * np.abs(by_value).max())
    assert_allclose(gradient, np.swapaxes(gradient, 1, 2), atol=1e-14 * np.abs(gradient).max())


def test_from_afar_it_is_a_dipole():
    """At a thousand radii the difference is of the order of the squared ratio."""
    offsets, moment = 445 * np.random.default_rng(4).normal(size=(10, 3)), np.array([100.0, -300.0, 200.0])
    for ours, theirs in zip(loop_field(offsets, moment, RADIUS), dipole_field(offsets, moment), strict=True):
        assert_allclose(ours, theirs, atol=2e-5 * np.abs(theirs).max())


def test_all_leading_axes_are_broadcast():
    """Many loops at many points at once give what each gives at each."""
    generator = np.random.default_rng(4)
    offsets, moments = generator.normal(size=(5, 4, 3)), generator.normal(size=(5, 1, 3))
    field, gradient, by_moment = loop_field(offsets, moments, RADIUS)
    one = loop_field(offsets[3, 2], moments[3, 0], RADIUS)
    for all_of_them, single in zip((field, gradient, by_moment), one, strict=True):
        assert_allclose(all_of_them[3, 2], single, rtol=1e-12)
