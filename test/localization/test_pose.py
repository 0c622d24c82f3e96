"""Ellipsoids and poses of sources: held against the eigenvectors of the covariance and against draws from it."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.localization.solutions import EulerSolutions, ellipsoid, pose_rows


def solutions_of(moments):
    """Return located sources with moments and random covariances."""
    rng = np.random.default_rng(5)
    count = len(moments)
    roots = 0.05 * rng.normal(size=(2, count, 3, 3))
    covariances = roots @ roots.transpose(0, 1, 3, 2)
    moment_Am2 = np.array(moments, dtype=float)
    return EulerSolutions(
        rng.normal(size=(count, 3)), covariances[0], moment_Am2, covariances[1], np.zeros(count, dtype=int)
    )


@pytest.mark.parametrize("seed", range(4))
def test_the_ellipsoid_has_the_axes_of_the_covariance(seed):
    """Its semi-axes lie along the eigenvectors, √7.815 standard deviations long, and 95 % of draws are in it."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(3, 3)) * [1, 0.3, 0.05]
    covariance = root @ root.T
    semi_axes, quaternion = ellipsoid(covariance)
    axes = Rotation.from_quat(quaternion).as_matrix()
    assert_allclose(axes @ np.diag(semi_axes**2) @ axes.T / 7.814727903251179, covariance, rtol=1e-9, atol=1e-12)
    inside = np.linalg.norm(rng.normal(size=(100_000, 3)) @ root.T @ axes / semi_axes, axis=1) < 1
    assert inside.mean() == pytest.approx(0.95, abs=0.003)


def test_a_pose_points_along_the_moment():
    """Also along the axes and against x, where the shortest rotation is any of many."""
    moments = [[5, 0, 0], [-5, 0, 0], [0, 2, 0], [0, 0, -3], [-1, 1e-9, 0], [0.3, -0.2, 0.7]]
    solutions = solutions_of(moments)
    rows = pose_rows(solutions)
    assert_allclose(rows[:, :3], solutions.position_m)
    unit = solutions.moment_Am2 / np.linalg.norm(solutions.moment_Am2, axis=1, keepdims=True)
    assert_allclose(Rotation.from_quat(rows[:, 3:7]).apply([1, 0, 0]), unit, atol=2e-9)
    covariance = rows[:, 7:].reshape(-1, 6, 6)
    assert_allclose(covariance[:, :3, :3], solutions.position_covariance_m2)
    assert not covariance[:, :3, 3:].any() and not covariance[:, 3:, :3].any()


def test_the_covariance_of_the_orientation_is_that_of_the_moments_direction():
    """Of many draws of the moment, each seen as the rotation that takes the mean there; about it is any angle."""
    solutions = solutions_of([[4, -7, 2]])
    mean, covariance = solutions.moment_Am2[0], solutions.moment_covariance_A2m4[0]
    drawn = np.random.default_rng(6).multivariate_normal(mean, covariance, 200_000)
    unit = mean / np.linalg.norm(mean)
    rotations = np.cross(unit, drawn / np.linalg.norm(drawn, axis=1, keepdims=True))
    told = pose_rows(solutions)[0, 7:].reshape(6, 6)[3:, 3:]
    around = np.pi**2 / 3 * np.outer(unit, unit)
    assert_allclose(told - around, np.cov(rotations.T), atol=0.02 * np.abs(np.cov(rotations.T)).max())
    assert unit @ told @ unit == pytest.approx(np.var(np.random.default_rng(7).uniform(-np.pi, np.pi, 10**6)), rel=5e-3)


def test_without_a_moment_any_orientation_is():
    """A line of current has none."""
    rows = pose_rows(solutions_of([[np.nan] * 3]))
    assert rows[0, 3:7].tolist() == [0, 0, 0, 1]
    assert_allclose(rows[0, 7:].reshape(6, 6)[3:, 3:], np.pi**2 / 3 * np.eye(3))


def test_every_pose_has_a_unit_quaternion():
    """Against x too, where the shortest rotation is any of many, and where there is no moment."""
    rows = pose_rows(solutions_of([[-5, 0, 0], [5, 0, 0], [-1, 1e-9, 0], [0.3, -0.2, 0.7], [np.nan] * 3]))
    assert_allclose(np.linalg.norm(rows[:, 3:7], axis=1), 1.0, rtol=1e-12)


def test_rounding_makes_no_imaginary_axis():
    """Of a place that is certain along one axis rounding may leave a variance below zero."""
    semi_axes, _ = ellipsoid(np.diag([1.0, -1e-18, 4.0]))
    assert_allclose(semi_axes / np.sqrt(7.814727903251179), [0.0, 1.0, 2.0])
