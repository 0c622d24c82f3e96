import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.passage import GRADIENT, UNIFORM, VELOCITY
from tam_calibration.localization.steady import locate_steady, straight_track, track_dipole
from tam_calibration.localization.turned_samples import Regional
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import noise_floor
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.sources.dipole import Dipole
from tam_calibration.sources.poses import Poses

from .conftest import EARTH_T, GRADIENT_T_PER_M, Course

ARRAY = Array.cross(0.5, vector_noise_T=1e-9)
TIME_S = np.arange(300) / 5
POSITION_M = straight_track(TIME_S, np.array([-30.0, 0, 0]), np.array([1.0, 0, 0]))
SOURCE = Dipole(np.array([2.0, 3.0, -2.5]), np.array([100.0, 200.0, -300.0]))
REGIONAL = np.array([1e-6, 2e-5, -4.5e-5])
SWAY = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(TIME_S, [0.2, 0.33, 0.5])))
WRECK = Dipole(np.array([30.0, 2.6, -2.5]), 160 * np.array([0.3, -0.5, 0.8]) / norm([0.3, -0.5, 0.8]))
"""160 A m², passed 3.6 m away."""


def pass_by(generator, attitude_noise=0.0):
    """Return the readings of a platform that sways as it passes, and its poses as they are reported."""
    matrix = SWAY.as_matrix()
    points = POSITION_M[:, None] + np.einsum("nij,kj->nki", matrix, ARRAY.positions_m)
    fields = np.einsum("nji,nkj->nki", matrix, SOURCE.field_T(points) + REGIONAL)
    reported = SWAY * Rotation.from_rotvec(attitude_noise * generator.normal(size=(len(TIME_S), 3)))
    noise = 1e-9 * generator.normal(size=fields.shape)
    return fields + noise, Poses(reported.as_quat(), POSITION_M, attitude_noise)


def pulls_of(found, covariance, source):
    """Return how far place and moment (6,) are off, in standard errors."""
    off = np.concatenate([found.position_m - source.position_m, found.moment_Am2 - source.moment_Am2])
    return off / np.sqrt(np.diag(covariance))


def tracked(course, sources, seed, velocity_error_m_per_s=0.1, regional=None):
    """Return what is found on a course."""
    fields, poses = course.seen(sources, np.random.default_rng(seed))
    settings = {"time_s": course.time_s, "velocity_error_m_per_s": velocity_error_m_per_s}
    return track_dipole(fields, course.array, poses, regional, **settings)


@pytest.mark.parametrize("attitude_noise_deg", [0.0, 0.1])
@pytest.mark.parametrize("regional", [Regional(REGIONAL), None], ids=["known", "fitted"])
def test_dipole_is_found_as_well_as_its_standard_errors_say(regional, attitude_noise_deg):
    """With and without an error of the attitude that turns 87 nT of the regional field into every reading."""
    generator = np.random.default_rng(31)
    pulls, chi_square = [], []
    for _ in range(6):
        fields, poses = pass_by(generator, from_degrees(attitude_noise_deg))
        track = track_dipole(fields, ARRAY, poses, regional)
        [(source, covariance)] = track.sources
        pulls.append(pulls_of(source, covariance, SOURCE))
        freedom = track.passage.degrees_of_freedom - 6
        chi_square.append(track.fit.solution.chi_square[0] / freedom)
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.7)
    assert np.mean(chi_square) == pytest.approx(1, abs=0.05)
    assert np.sqrt(np.diag(covariance)[:3]).max() < 8e-3


def test_samples_near_the_dipole_find_it_by_themselves():
    """Each solution in the world lies within what its covariance says; the far ones are refused."""
    fields, poses = pass_by(np.random.default_rng(32))
    track = track_dipole(fields, ARRAY, poses, Regional(REGIONAL))
    located = track.samples.is_located
    assert 20 < located.sum() < 250
    nearest = np.argmin(np.linalg.norm(POSITION_M - SOURCE.position_m, axis=1))
    assert located[nearest - 5 : nearest + 5].all()
    places = POSITION_M + SWAY.apply(track.samples.position_m)
    errors = places[located] - SOURCE.position_m
    variance = np.trace(track.samples.position_covariance_m2[located], axis1=1, axis2=2)
    assert np.mean(np.sum(errors**2, axis=1) / variance) == pytest.approx(1, abs=0.4)


def test_regional_field_is_fitted_from_the_samples_far_away():
    """To a part of a nanotesla, and to its standard errors."""
    fields, poses = pass_by(np.random.default_rng(33))
    track = track_dipole(fields, ARRAY, poses)
    field = track.passage.further(track.unknowns)[UNIFORM]
    assert_allclose(field, REGIONAL, atol=3e-10)
    errors = np.sqrt(np.diag(track.further_covariance))[UNIFORM]
    assert (np.abs(field - REGIONAL) < 4 * errors).all() and (errors < 1e-10).all()


@pytest.mark.parametrize("seed", range(3))
def test_a_gradient_of_the_regional_field_is_found(seed):
    """2 nT/m beside 0.1 nT of noise: source and gradient within four standard errors, and these are small."""
    track = tracked(Course(), [WRECK], seed)
    [(source, covariance)] = track.sources
    assert (np.abs(pulls_of(source, covariance, WRECK)) < 4).all()
    assert np.sqrt(np.diag(covariance)[:3]).max() < 0.01
    gradient = track.passage.further(track.unknowns)[GRADIENT]
    errors = np.sqrt(np.diag(track.further_covariance))[GRADIENT]
    off = np.tensordot(gradient, UNIT_TENSORS, 1) - GRADIENT_T_PER_M
    assert (np.abs(off[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]) < 4 * errors).all()
    assert (errors < 3e-11).all()
    assert track.fit.misfit.variance_factor == 1


def test_an_error_of_the_velocity_is_found():
    """3 % of the speed, with a standard error of a tenth: source and velocity within four standard errors."""
    truth = np.array([0.03, 0.01, -0.02])
    track = tracked(Course(velocity_error_m_per_s=truth), [WRECK], 4)
    [(source, covariance)] = track.sources
    assert (np.abs(pulls_of(source, covariance, WRECK)) < 4).all()
    off = track.passage.further(track.unknowns)[VELOCITY] - truth
    errors = np.sqrt(np.diag(track.further_covariance))[VELOCITY]
    assert (np.abs(off) < 4 * errors).all() and (errors < 1e-3).all()


def test_a_velocity_that_is_taken_as_exact_is_refused_where_it_is_not():
    """The scale of the track is then wrong, and the readings are those of no dipole."""
    with pytest.raises(Refused, match="larger error of the velocity"):
        tracked(Course(80, velocity_error_m_per_s=(0.03, 0.0, 0.0)), [WRECK], 4, velocity_error_m_per_s=0.0)


def test_a_velocity_that_is_not_as_stated_is_refused():
    """3 % off, stated to 0.1 %: found where it is, thirty standard errors away; stated to 1 % it does no harm."""
    course = Course(80, velocity_error_m_per_s=(0.03, 0.0, 0.0))
    with pytest.raises(Refused, match="standard errors from what is stated: check the velocity"):
        tracked(course, [WRECK], 4, velocity_error_m_per_s=0.001)
    [(source, covariance)] = tracked(course, [WRECK], 4, velocity_error_m_per_s=0.01).sources
    assert (np.abs(pulls_of(source, covariance, WRECK)) < 4).all()


def test_pulls_have_their_size_with_errors_of_the_attitude():
    """0.1° in 50 µT are 900 times the noise of 0.1 nT: over ten passes the pulls' squares are one in the mean."""
    pulls = []
    for seed in range(10):
        track = tracked(Course(80, attitude_noise=from_degrees(0.1)), [WRECK], seed)
        [(source, covariance)] = track.sources
        pulls.append(pulls_of(source, covariance, WRECK))
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.3
    assert np.abs(pulls).max() < 4.5


def test_a_known_field_is_knowledge_and_no_more():
    """A model of the field that is off by its standard error does no harm; taken as exact it is refused."""
    off = 140e-9 * np.array([1.2, -0.8, 1.0])
    uncertain = tracked(Course(80), [WRECK], 5, regional=Regional(EARTH_T + off, 0.0, 140e-9**2 * np.eye(3)))
    [(source, covariance)] = uncertain.sources
    assert (np.abs(pulls_of(source, covariance, WRECK)) < 4).all()
    with pytest.raises(Refused):
        tracked(Course(80), [WRECK], 5, regional=Regional(EARTH_T + off))


def test_what_is_known_better_than_the_readings_tell_it_is_used():
    """The standard errors of the field are then those that are known, and the source's no larger."""
    without = tracked(Course(samples=60), [WRECK], 6)
    known = tracked(Course(samples=60), [WRECK], 6, regional=Regional(EARTH_T, 0.0, 1e-12**2 * np.eye(3)))
    loose, tight = (np.sqrt(np.diag(each.further_covariance))[UNIFORM] for each in (without, known))
    assert (loose > 5e-12).all()
    assert_allclose(tight, 1e-12, rtol=0.05)
    assert (np.diag(known.sources[0][1]) <= np.diag(without.sources[0][1]) * 1.001).all()


def test_bad_tracks_are_refused():
    """A track needs three numbers, poses need as many positions as attitudes, all finite."""
    with pytest.raises(InputError, match="three finite numbers"):
        straight_track(TIME_S, np.zeros(2), np.zeros(3))
    with pytest.raises(InputError, match="poses need"):
        Poses(SWAY.as_quat(), POSITION_M[:5])
    with pytest.raises(InputError, match="not finite"):
        Poses(SWAY.as_quat(), np.full_like(POSITION_M, np.nan))


def perfect():
    """Return the calibration of sensors without errors, known exactly."""
    errors = SensorErrors.none(4)
    floor = noise_floor(errors, ARRAY, 1e-10)
    return Calibration(
        "maximum_likelihood", ARRAY, False, errors, None, True, 48e-6, floor, floor, floor, 100, (0.0, 1.0), 1.0
    )


def test_a_survey_along_a_track_tells_place_and_moment_with_their_errors():
    """In the world, of all samples whose attitude is known: pulls of both have their size, and are no larger."""
    generator, pulls = np.random.default_rng(35), []
    begin = Dipole(SOURCE.position_m - POSITION_M[0], SOURCE.moment_Am2)
    for _ in range(6):
        fields, poses = pass_by(generator)
        attitude = poses.attitude.copy()
        attitude[5:8] = np.nan
        recording = Recording(TIME_S, fields, attitude=attitude)
        along = {"velocity_m_per_s": np.array([1.0, 0, 0]), "velocity_error_m_per_s": 1e-3}
        survey = locate_steady(recording, perfect(), **along)
        found = survey.overall
        assert len(survey.time_s) == len(TIME_S) - 3
        assert found.moment_covariance_A2m4.shape == (3, 3)
        covariance = block_diag(found.position_covariance_m2, found.moment_covariance_A2m4)
        pulls.append(pulls_of(found, covariance, begin))
    assert np.mean(np.square(pulls)) == pytest.approx(1, abs=0.7)


def test_without_a_velocity_every_sample_of_a_survey_stands_by_itself():
    """As they are located along the track before all are taken together: places count from the array."""
    fields, poses = pass_by(np.random.default_rng(36))
    survey = locate_steady(Recording(TIME_S, fields, attitude=poses.attitude), perfect(), regional_T=REGIONAL)
    located = survey.solutions.is_located
    place = survey.solutions.position_m[located] + POSITION_M[located]
    assert located.sum() > 20 and norm(np.median(place, axis=0) - SOURCE.position_m) < 0.1
