"""Attitudes over time, the site's field, its drift, and a dipole."""

import magpylib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.model.exceptions import InputError
from tam_calibration.simulation.conditions import (
    Manoeuvre,
    ObservedDrift,
    RampDrift,
    RandomAttitudes,
    RandomEulerAngles,
    SinusoidDrift,
    ThreeAxisTurns,
    Tumble,
    Turntable,
    field_from_elements,
)
from tam_calibration.sources.dipole import Dipole

SITE = np.array([-4e-6, 25e-6, -48e-6])
VECTORS = arrays(float, 3, elements=st.floats(-5, 5))


@given(intensity=st.floats(20e-6, 70e-6), inclination=st.floats(-1.5, 1.5), declination=st.floats(-3.1, 3.1))
def test_elements_come_back(intensity, inclination, declination):
    """Intensity, inclination and declination of the field are those asked for."""
    east, north, up = field_from_elements(intensity, inclination, declination)
    assert_allclose(np.linalg.norm([east, north, up]), intensity, rtol=1e-12)
    assert_allclose(np.arctan2(-up, np.hypot(east, north)), inclination, atol=1e-12)
    assert_allclose(np.arctan2(east, north), declination, atol=1e-12)


@pytest.mark.parametrize("drift", [SinusoidDrift(8.26e-9, 40.0), RampDrift(8.26e-9)])
@pytest.mark.parametrize("count", [2, 72, 1001])
def test_drift_has_the_stated_standard_deviation(drift, count):
    """The intensity of the drifting field has the standard deviation asked for and the site's as mean."""
    field = SITE + drift.variation_T(np.arange(count) * 0.7, SITE)
    intensity = np.linalg.norm(field, axis=1)
    assert_allclose(intensity.std(), 8.26e-9, rtol=1e-6)
    assert_allclose(intensity.mean(), np.linalg.norm(SITE), rtol=1e-12)


@pytest.mark.parametrize("drift", [SinusoidDrift(8.26e-9, 40.0), RampDrift(8.26e-9)])
def test_one_sample_cannot_drift(drift):
    """A single sample has no standard deviation."""
    with pytest.raises(InputError, match="one sample cannot drift"):
        drift.variation_T(np.zeros(1), SITE)


def test_observed_drift_is_turned_into_the_meridian_of_the_site():
    """A rise of H raises the horizontal intensity, one of E turns the field to the east, one of Z raises that down."""
    time = np.arange(0, 100, 10.0)
    for axis, direction in enumerate([(-4 / np.hypot(4, 25), 25 / np.hypot(4, 25), 0), (25, 4, 0), (0, 0, -1)]):
        record = np.zeros((10, 3))
        record[:, axis] = np.linspace(-45e-9, 45e-9, 10)
        variation = ObservedDrift(time, record).variation_T(np.array([5.0, 85.0]), SITE)
        expected = 80e-9 * np.array(direction) / np.linalg.norm(direction)
        assert_allclose(variation[1] - variation[0], expected, atol=1e-15)


def test_observed_drift_leaves_the_mean_to_the_site():
    """The record's own level does not matter, only its change."""
    time = np.arange(5.0)
    record = np.full((5, 3), 3e-5) + np.outer(np.arange(5), [1e-9, 2e-9, 3e-9])
    assert_allclose(ObservedDrift(time, record).variation_T(time, SITE).mean(axis=0), 0, atol=1e-18)


@pytest.mark.parametrize(("start", "gap"), [(0.0, True), (3.0, False), (-1.0, False)])
def test_observed_drift_refuses_a_gap(start, gap):
    """A missing value in the span, or a record that is too short, is said and not invented."""
    record = np.zeros((5, 3))
    if gap:
        record[2, 1] = np.nan
    with pytest.raises(InputError, match="gap within the 4 s of the simulation"):
        ObservedDrift(np.arange(5.0), record).variation_T(start + np.arange(5.0), SITE)


@given(VECTORS, VECTORS, VECTORS)
def test_dipole_agrees_with_magpylib(position, moment, offset):
    """The field is that of an independent implementation."""
    if np.linalg.norm(offset) < 0.1:
        offset = offset + np.array([0.5, 0, 0])
    points = position + np.array([offset, -offset])
    expected = magpylib.misc.Dipole(position=position, moment=moment).getB(points)
    assert_allclose(Dipole(position, moment).field_T(points), expected, rtol=1e-7, atol=1e-20)


@given(VECTORS, VECTORS)
def test_gradient_is_symmetric_trace_free_and_the_derivative_of_the_field(moment, point):
    """Outside its source the tensor obeys Maxwell, and it is the slope of the field."""
    if np.linalg.norm(point) < 0.5:
        point = point + np.array([1.0, 0, 0])
    dipole = Dipole(np.zeros(3), moment)
    gradient = dipole.gradient_T_per_m(point)
    scale = 1e-7 * (np.linalg.norm(moment) + 1e-12) / np.linalg.norm(point) ** 4
    step = 1e-4 * np.linalg.norm(point)
    slope = (dipole.field_T(point + step * np.eye(3)) - dipole.field_T(point - step * np.eye(3))).T / (2 * step)
    assert_allclose(gradient, gradient.T, atol=1e-12 * scale)
    assert_allclose(np.trace(gradient), 0, atol=1e-12 * scale * 15)
    assert_allclose(gradient, slope, atol=1e-5 * scale)


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
