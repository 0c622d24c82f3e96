import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.localization.steady import straight_track, track_dipole, without_regional
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import from_degrees
from tam_calibration.sources.dipole import Dipole
from tam_calibration.sources.poses import Poses

ARRAY = Array.cross(0.5, vector_noise_T=1e-9)
TIME_S = np.arange(300) / 5
POSITION_M = straight_track(TIME_S, np.array([-30.0, 0, 0]), np.array([1.0, 0, 0]))
SOURCE = Dipole(np.array([2.0, 3.0, -2.5]), np.array([100.0, 200.0, -300.0]))
REGIONAL = np.array([1e-6, 2e-5, -4.5e-5])
SWAY = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(TIME_S, [0.2, 0.33, 0.5])))


def pass_by(generator, attitude_noise=0.0):
    """Return the readings of a platform that sways as it passes, and its poses as they are reported."""
    matrix = SWAY.as_matrix()
    points = POSITION_M[:, None] + np.einsum("nij,kj->nki", matrix, ARRAY.positions_m)
    fields = np.einsum("nji,nkj->nki", matrix, SOURCE.field_T(points) + REGIONAL)
    reported = SWAY * Rotation.from_rotvec(attitude_noise * generator.normal(size=(len(TIME_S), 3)))
    noise = 1e-9 * generator.normal(size=fields.shape)
    return fields + noise, Poses(reported.as_quat(), POSITION_M, attitude_noise)


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.1])
@pytest.mark.parametrize("regional", [REGIONAL, None], ids=["known", "fitted"])
def test_dipole_is_found_as_well_as_its_standard_errors_say(regional, attitude_noise_deg):
    """With and without an error of the attitude that turns 87 nT of the regional field into every reading."""
    generator = np.random.default_rng(31)
    pulls, chi_square = [], []
    for _ in range(12):
        fields, poses = pass_by(generator, from_degrees(attitude_noise_deg))
        track = track_dipole(fields, ARRAY, poses, regional)
        pulls.append((track.fit.source.position_m - SOURCE.position_m) / track.fit.position_standard_errors_m)
        chi_square.append(track.fit.chi_square / track.fit.degrees_of_freedom)
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.7)
    assert np.mean(chi_square) == pytest.approx(1, abs=0.05)
    assert track.fit.position_standard_errors_m.max() < 6e-3


def test_samples_near_the_dipole_find_it_by_themselves():
    """Each solution in the world lies within what its covariance says; the far ones are refused."""
    fields, poses = pass_by(np.random.default_rng(32))
    track = track_dipole(fields, ARRAY, poses, REGIONAL)
    located = track.samples.is_located
    assert 20 < located.sum() < 250
    nearest = np.argmin(np.linalg.norm(POSITION_M - SOURCE.position_m, axis=1))
    assert located[nearest - 5 : nearest + 5].all()
    errors = track.sample_position_m[located] - SOURCE.position_m
    variance = np.trace(track.samples.position_covariance_m2[located], axis1=1, axis2=2)
    assert np.mean(np.sum(errors**2, axis=1) / variance) == pytest.approx(1, abs=0.4)


def test_regional_field_is_fitted_from_the_samples_far_away():
    """To a part of a nanotesla."""
    track = track_dipole(*_swap(pass_by(np.random.default_rng(33))))
    assert_allclose(track.regional_T, REGIONAL, atol=2e-10)


def _swap(made):
    return made[0], ARRAY, made[1]


def test_regional_field_is_taken_off_in_the_array_frame():
    """What is left of readings in it alone is nothing."""
    uniform = np.repeat(SWAY.inv().apply(REGIONAL)[:, None], 4, axis=1)
    assert_allclose(without_regional(uniform, SWAY.as_quat(), REGIONAL), 0, atol=1e-19)


def test_bad_tracks_are_refused():
    """A track needs three numbers, poses need as many positions as attitudes, all finite."""
    with pytest.raises(InputError, match="three finite numbers"):
        straight_track(TIME_S, np.zeros(2), np.zeros(3))
    with pytest.raises(InputError, match="poses need"):
        Poses(SWAY.as_quat(), POSITION_M[:5])
    with pytest.raises(InputError, match="not finite"):
        Poses(SWAY.as_quat(), np.full_like(POSITION_M, np.nan))
