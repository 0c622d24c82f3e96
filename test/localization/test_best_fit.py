"""A dipole or a loop fitted to readings of one pose or of many."""

from functools import partial

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.localization.passage import UNIFORM, Known, passage_of
from tam_calibration.localization.track_fit import best_fit
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.sources.dipole import Dipole, Loop, area_of, dipole_field, loop_field
from tam_calibration.sources.poses import Poses

RADIUS = 0.445
PLACE = np.array([2.40, -1.00, 0.46])
MOMENT = Rotation.from_rotvec([0.5, -0.8, 0.3]).apply([0, 0, 708 * area_of(RADIUS)])
ARRAY = Array.cross(0.21, vector_noise_T=5e-11)
TURNS = Rotation.from_euler("z", np.arange(12)[:, None] * np.pi / 6)
POSES, ONE_POSE = Poses.headings(TURNS.as_quat()), Poses.headings(TURNS[:1].as_quat())
LOOP, DIPOLE = Loop(PLACE, MOMENT, RADIUS), Dipole(PLACE, MOMENT)
LOOP_FIELD = partial(loop_field, radius_m=RADIUS)
NOTHING = Known(np.zeros(11), np.zeros(11))


def readings_of(source, poses=POSES, uniform=(0, 0, 0)):
    """Return the (N, K, 3) fields at the sensors in the array frame."""
    points = poses.position_m[:, None] + np.einsum("nij,kj->nki", poses.matrix, ARRAY.positions_m)
    return np.einsum("nji,nkj->nki", poses.matrix, source.field_T(points) + np.asarray(uniform))


def fit_of(kernel, readings, array=ARRAY, poses=POSES, known=NOTHING):
    """Return the fit of one source."""
    return best_fit(passage_of(kernel, readings, array, poses, known), 1)


def test_source_is_found_exactly():
    """Dipole and loop, from one pose and from twelve headings, to rounding."""
    for poses in (POSES, Poses.headings(TURNS[3:4].as_quat())):
        for kernel, source in ((dipole_field, DIPOLE), (LOOP_FIELD, LOOP)):
            fit = fit_of(kernel, readings_of(source, poses), poses=poses)
            assert_allclose(fit.unknowns[0, :3], PLACE, atol=1e-9)
            assert_allclose(fit.unknowns[0, 3:], MOMENT, atol=1e-6)


def test_loop_taken_for_a_dipole_is_wrong_by_a_per_cent():
    """And its residual tells."""
    fit = fit_of(dipole_field, readings_of(LOOP))
    assert 0.01 < norm(fit.unknowns[0, :3] - PLACE) / norm(PLACE) < 0.03
    assert fit.chi_square[0] > 10 * 138


def test_standard_errors_are_those_of_repeated_measurements():
    """Of the position and of the size of the moment."""
    generator = np.random.default_rng(21)
    exact = readings_of(LOOP)
    fits = [fit_of(LOOP_FIELD, exact + 5e-11 * generator.normal(size=exact.shape)) for _ in range(150)]
    pulls = [(fit.unknowns[0, :3] - PLACE) / np.sqrt(np.diag(fit.covariance[0])[:3]) for fit in fits]
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.25)
    along = MOMENT / norm(MOMENT)
    moments = [
        (norm(fit.unknowns[0, 3:]) - norm(MOMENT)) / np.sqrt(along @ fit.covariance[0, 3:, 3:] @ along) for fit in fits
    ]
    assert np.mean(np.square(moments)) == pytest.approx(1, abs=0.4)
    assert np.mean([fit.chi_square for fit in fits]) == pytest.approx(138, abs=6)


def test_uniform_field_is_known_or_fitted_beside_a_source_that_is_passed():
    """With the platform moving, both give the dipole."""
    uniform = np.array([1e-6, 2e-5, -4.5e-5])
    poses = Poses(TURNS.as_quat(), np.linspace([-4, 0, 0], [6, 1, 0], 12))
    readings = readings_of(DIPOLE, poses, uniform)
    expected, free = np.zeros(11), np.zeros(11)
    expected[UNIFORM], free[UNIFORM] = uniform, np.inf
    known = fit_of(dipole_field, readings, poses=poses, known=Known(expected, np.zeros(11)))
    fitted = fit_of(dipole_field, readings, poses=poses, known=Known(np.zeros(11), free))
    assert_allclose(known.unknowns[0, :3], PLACE, atol=1e-7)
    assert_allclose(fitted.unknowns[0, :3], PLACE, atol=1e-7)
    assert_allclose(fitted.unknowns[0, 6:], uniform, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda fields: fields[:5], "shape"),
        (lambda fields: np.where(fields == fields[0, 0, 0], np.nan, fields), "not finite"),
    ],
)
def test_readings_that_are_none_are_refused(change, message):
    """Wrong shape, and not finite."""
    with pytest.raises(InputError, match=message):
        passage_of(dipole_field, change(readings_of(DIPOLE)), ARRAY, POSES, NOTHING)


def test_arrays_that_show_no_source_are_refused():
    """Too few values, axes in different places, and no gradient, which gives nowhere to start."""
    one = Array(np.zeros((1, 3)))
    with pytest.raises(Refused, match="do not determine"):
        passage_of(dipole_field, np.ones((1, 1, 3)), one, ONE_POSE, NOTHING)
    with pytest.raises(InputError, match="in one place"):
        apart = Array(ARRAY.positions_m, axis_offsets_m=np.zeros((4, 3, 3)))
        passage_of(dipole_field, readings_of(DIPOLE), apart, POSES, NOTHING)
    with pytest.raises(Refused, match="nowhere to start"):
        passage_of(dipole_field, np.ones((12, 1, 3)), one, POSES, NOTHING)


@pytest.mark.parametrize(("unknowns", "reason"), [(0, "nowhere to start"), (1, "6 values do not determine 7 unknowns")])
def test_one_value_less_than_unknowns_is_too_few(unknowns, reason):
    """Two sensors read as many values as a source has unknowns, and too few for one more."""
    error = np.zeros(11)
    error[:unknowns] = np.inf
    pair = Array(np.array([[0.25, 0.0, 0.0], [-0.25, 0.0, 0.0]]))
    with pytest.raises(Refused, match=reason):
        passage_of(dipole_field, np.ones((1, 2, 3)), pair, ONE_POSE, Known(np.zeros(11), error))
