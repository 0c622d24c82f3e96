import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.localization.direct_fit import fit_dipole, fit_loop, passage_of
from tam_calibration.localization.passage import Known
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.sources.dipole import Dipole, dipole_field
from tam_calibration.sources.loop import Loop, area_of
from tam_calibration.sources.poses import ONE_POSE, Poses

RADIUS = 0.445
PLACE = np.array([2.40, -1.00, 0.46])
MOMENT = Rotation.from_rotvec([0.5, -0.8, 0.3]).apply([0, 0, 708 * area_of(RADIUS)])
ARRAY = Array.cross(0.21, vector_noise_T=5e-11)
TURNS = Rotation.from_euler("z", np.arange(12)[:, None] * np.pi / 6)
POSES = Poses.headings(TURNS.as_quat())
LOOP, DIPOLE = Loop(PLACE, MOMENT, RADIUS), Dipole(PLACE, MOMENT)


def readings_of(source, poses=POSES, uniform=(0, 0, 0)):
    """Return the (N, K, 3) fields at the sensors in the array frame."""
    points = poses.position_m[:, None] + np.einsum("nij,kj->nki", poses.matrix, ARRAY.positions_m)
    return np.einsum("nji,nkj->nki", poses.matrix, source.field_T(points) + np.asarray(uniform))


def test_source_is_found_exactly():
    """Dipole and loop, from one pose and from twelve headings, to rounding; the current of the loop too."""
    for poses in (POSES, Poses.headings(TURNS[3:4].as_quat())):
        dipole, loop = (
            fit_dipole(readings_of(DIPOLE, poses), ARRAY, poses),
            fit_loop(readings_of(LOOP, poses), ARRAY, RADIUS, poses),
        )
        for fit in (dipole, loop):
            assert_allclose(fit.source.position_m, PLACE, atol=1e-9)
            assert_allclose(fit.source.moment_Am2, MOMENT, atol=1e-6)
            assert fit.degrees_of_freedom == 12 * len(poses.attitude) - 6
            assert fit.uniform_field_T is None
        assert loop.source.current_A == pytest.approx(708)
        assert np.isnan(dipole.current_standard_error_A)


def test_without_poses_the_source_is_in_the_array_frame():
    """One pose, in which the array frame is the world."""
    fit = fit_loop(readings_of(LOOP, Poses.headings(TURNS[:1].as_quat())), ARRAY, RADIUS)
    assert_allclose(fit.source.position_m, PLACE, atol=1e-9)


def test_loop_taken_for_a_dipole_is_wrong_by_a_per_cent():
    """And its residual tells."""
    fit = fit_dipole(readings_of(LOOP), ARRAY, POSES)
    assert 0.01 < norm(fit.source.position_m - PLACE) / norm(PLACE) < 0.03
    assert fit.chi_square > 10 * fit.degrees_of_freedom


@pytest.mark.parametrize("states_noise", [True, False])
def test_standard_errors_are_those_of_repeated_measurements(states_noise):
    """Of position, moment and current, whether the noise is stated or taken from the residuals."""
    generator = np.random.default_rng(21)
    array = ARRAY if states_noise else Array(ARRAY.positions_m)
    exact = readings_of(LOOP)
    fits = [fit_loop(exact + 5e-11 * generator.normal(size=exact.shape), array, RADIUS, POSES) for _ in range(150)]
    pulls = [(fit.source.position_m - PLACE) / fit.position_standard_errors_m for fit in fits]
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.25)
    currents = [(fit.source.current_A - 708) / fit.current_standard_error_A for fit in fits]
    assert np.mean(np.square(currents)) == pytest.approx(1, abs=0.4)
    assert np.mean([fit.chi_square for fit in fits]) == pytest.approx(138, abs=6)


def test_uniform_field_is_known_or_fitted_beside_a_source_that_is_passed():
    """With the platform moving, both give the dipole; a field that is both known and fitted is refused."""
    uniform = np.array([1e-6, 2e-5, -4.5e-5])
    poses = Poses(TURNS.as_quat(), np.linspace([-4, 0, 0], [6, 1, 0], 12))
    readings = readings_of(DIPOLE, poses, uniform)
    known = fit_dipole(readings, ARRAY, poses, uniform_field_T=uniform)
    fitted = fit_dipole(readings, ARRAY, poses, fit_uniform_field=True)
    assert_allclose(known.source.position_m, PLACE, atol=1e-7)
    assert_allclose(fitted.source.position_m, PLACE, atol=1e-7)
    assert_allclose(fitted.uniform_field_T, uniform, atol=1e-14)
    assert fitted.covariance.shape == (9, 9)
    with pytest.raises(InputError, match="not both"):
        fit_dipole(readings, ARRAY, poses, uniform_field_T=uniform, fit_uniform_field=True)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (lambda fields: fields[:5], InputError, "shape"),
        (lambda fields: np.where(fields == fields[0, 0, 0], np.nan, fields), InputError, "not finite"),
        (lambda fields: 0 * fields, Refused, "no source"),
    ],
)
def test_readings_that_show_no_source_are_refused(change, error, message):
    """Wrong shape, not finite, and no field at all."""
    with pytest.raises(error, match=message):
        fit_dipole(change(readings_of(DIPOLE)), ARRAY, POSES)


def test_too_few_values_are_refused():
    """A radius must be positive, and an array without gradient gives nowhere to start."""
    with pytest.raises(InputError, match="radius"):
        fit_loop(readings_of(LOOP), ARRAY, -1.0, POSES)
    one = Array(np.zeros((1, 3)))
    with pytest.raises(Refused, match="do not determine"):
        fit_dipole(np.ones((1, 1, 3)), one)
    with pytest.raises(InputError, match="in one place"):
        fit_dipole(readings_of(DIPOLE), Array(ARRAY.positions_m, axis_offsets_m=np.zeros((4, 3, 3))), POSES)
    with pytest.raises(Refused, match="nowhere to start"):
        fit_dipole(np.ones((12, 1, 3)), one, POSES)


@pytest.mark.parametrize(("unknowns", "reason"), [(0, "nowhere to start"), (1, "6 values do not determine 7 unknowns")])
def test_one_value_less_than_unknowns_is_too_few(unknowns, reason):
    """Two sensors read as many values as a source has unknowns, and too few for one more."""
    error = np.zeros(11)
    error[:unknowns] = np.inf
    pair = Array(np.array([[0.25, 0.0, 0.0], [-0.25, 0.0, 0.0]]))
    with pytest.raises(Refused, match=reason):
        passage_of(dipole_field, np.ones((1, 2, 3)), pair, ONE_POSE, Known(np.zeros(11), error))
