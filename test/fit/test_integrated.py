from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.core.field_alignment import find_turn
from tam_calibration.fit import ellipsoid
from tam_calibration.fit.moments import gather
from tam_calibration.fit.published import _nearest, _turns, constrained_ellipsoid, integrated
from tam_calibration.model.exceptions import InputError
from tam_validation.papers import chi2017


@pytest.fixture(scope="module")
def case():
    """Return the simulation of Chi 2017, whose soft iron turns the frame of sensor 1 by tens of degrees."""
    return chi2017.set_up()


def ellipsoid_moments(axes, center, noise=0.0, part=1.0):
    """Return the moments of points on an ellipsoid with given half axes, or on the upper part of it."""
    generator = np.random.default_rng(5)
    direction = generator.normal(size=(400, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    direction = direction[direction[:, 2] > 1 - 2 * part]
    points = direction * axes + center + noise * generator.normal(size=direction.shape)
    rows = ellipsoid.monomial_columns(points.T, np.ones(len(points))).T
    return rows.T @ rows


@pytest.mark.parametrize("axes", [(1, 1, 1), (1, 1.5, 0.7), (0.2, 1, 1), (1, 0.1, 0.1), (1, 1, 0.09)])
def test_an_ellipsoid_is_found_exactly(axes):
    """Without noise shape and centre are exact, also for long and for flat ellipsoids."""
    center = np.array([0.2, -0.1, 0.3])
    shape, found = constrained_ellipsoid(ellipsoid_moments(np.array(axes), center), np.array(1.0))
    assert_allclose(found, center, atol=1e-10)
    assert_allclose(shape, np.diag(1 / np.square(axes)), rtol=1e-9, atol=1e-8)


def test_what_is_fitted_is_an_ellipsoid():
    """On a small cap of a noisy sphere, where a free quadric opens, the constraint still yields an ellipsoid."""
    moments = ellipsoid_moments(np.ones(3), np.zeros(3), noise=0.05, part=0.1)
    free = np.linalg.solve(moments[:9, :9], moments[:9, 9])
    assert np.linalg.eigvalsh(ellipsoid.symmetric(free[:6])).min() < 0
    shape, _ = constrained_ellipsoid(moments, np.array(1.0))
    assert np.linalg.eigvalsh(shape).min() > 0


def test_points_in_a_plane_are_refused():
    """A singular fit is a sentence, not a traceback."""
    with pytest.raises(InputError, match="do not lie on an ellipsoid"):
        constrained_ellipsoid(np.zeros((11, 11)), np.array(1.0))


def test_hard_and_soft_iron_are_taken_off(case):
    """With the paper's iron and no noise intensity and tensor of a uniform field are exact."""
    exact = replace(case.recording, readings_T=case.errors.distort(case.field_T))
    calibration = integrated(exact, case.array)
    assert calibration.before.tensor_rmse_T_per_m > 5e-5
    assert calibration.in_sample.tensor_rmse_T_per_m < 1e-16
    assert calibration.in_sample.sensor_intensity_T.max() < 1e-16


def test_the_frame_is_stated(case):
    """Without attitude the result says that the frame is turned; with it, that it is the array's."""
    blind = integrated(replace(case.recording, attitude=None), case.array)
    assert "soft iron" in blind.statements[0]
    assert (blind.errors.misalignment[0] == 0).all() or np.abs(blind.errors.misalignment[0]).max() < 1e-12
    seeing = integrated(case.recording, case.array)
    assert "attitude was recorded" in seeing.statements[0]
    error = (seeing.errors.to_vector() - case.errors.to_vector()) / seeing.standard_errors
    assert np.sqrt(np.mean(error**2)) < 2
    assert np.abs(seeing.errors.misalignment[0] - case.errors.misalignment[0]).max() < 1e-4


def test_samples_without_attitude_tell_the_rest(case):
    """An attitude that is unknown in a third of the samples turns the frame by the others."""
    attitude = case.recording.attitude.copy()
    attitude[::3] = np.nan
    some = integrated(replace(case.recording, attitude=attitude), case.array)
    whole = integrated(case.recording, case.array)
    assert_allclose(some.errors.misalignment, whole.errors.misalignment, atol=3 * whole.standard_errors[:, 9:].max())
    assert_allclose(some.errors.bias_T, whole.errors.bias_T)


@pytest.mark.parametrize("ratio", [100.0, 4.0])
def test_no_other_quadric_within_the_constraint_is_nearer(ratio):
    """Squared algebraic distances over ratio J - I², with I the trace of A and J the sum of its principal minors."""
    generator = np.random.default_rng(8)
    direction = generator.normal(size=(300, 3))
    points = direction / np.linalg.norm(direction, axis=1, keepdims=True) * [1, 1.5, 0.7] + [0.2, -0.1, 0.3]
    points += 0.05 * generator.normal(size=points.shape)
    rows = ellipsoid.monomial_columns(points.T, np.ones(len(points))).T
    shape, linear, constant = _nearest(rows.T @ rows, ratio)

    def distance(shape, linear, constant):
        algebraic = np.einsum("ni,ij,nj->n", points, shape, points) + points @ linear + constant
        trace = np.trace(shape)
        minors = (trace**2 - np.trace(shape @ shape)) / 2
        return np.sum(algebraic**2) / (ratio * minors - trace**2)

    least = distance(shape, linear, constant)
    for _ in range(50):
        step = 1e-3 * generator.normal(size=(3, 3)) * np.abs(shape).max()
        moved = 1e-3 * generator.normal(size=4) * np.abs(linear).max()
        assert distance(shape + step + step.T, linear + moved[:3], constant + moved[3]) > least > 0


def test_each_turn_is_that_of_the_samples_that_its_set_has(case):
    """The first of all samples, each other without those that are left out."""
    moments = gather(case.recording, "integrated")
    matrix, bias_T = case.errors.matrix, case.errors.bias_T
    center = (bias_T - moments.data.origin_T) / moments.data.radius_T
    field = (case.recording.readings_T[:, 0] - bias_T[0]) @ np.linalg.inv(matrix[0]).T / moments.data.radius_T
    to_world = Rotation.from_quat(case.recording.attitude).as_matrix()
    sets = [moments.set_without() == number for number in range(len(moments.joint))]
    expected = [find_turn(np.delete(field, out, axis=0), np.delete(to_world, out, axis=0)) for out in sets]
    found = _turns(moments, np.tile(matrix, (len(sets), 1, 1, 1)), np.tile(center, (len(sets), 1, 1)))
    assert np.abs(np.diff(expected, axis=0)).max() > 1e-9
    assert_allclose(found, expected, atol=1e-13)
