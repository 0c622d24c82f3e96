"""Where an alternating source is, with and without an attitude, of an array that stands still or never does.

Whether an alternating source has the frequency that is stated, and one phase.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.localization import alternating
from tam_calibration.localization.alternating import estimator_of, frequency_of, locate_alternating, require_one_phase
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.locate import locate_steady
from tam_calibration.localization.solutions import ARRAY_FRAME, WORLD_FRAME
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.sources.demodulation import Stretch, background_of, demodulate, turning_of
from tam_calibration.sources.dipole import Dipole

from .conftest import calibration_of

EARTH_T = np.array([1e-6, 21e-6, -43e-6])
FREQUENCY_HZ, RATE_HZ = 10.0, 100.0
COIL = Dipole(np.array([2.4, -1.0, 0.46]), np.array([30.0, -20.0, 25.0]))
ARRAY = Array.cross(0.5, 1e-9, 1e-10)
STILL = Rotation.from_euler("z", np.repeat([[0.0], [1.0], [2.0]], 200, axis=0))
SWAYING = Rotation.from_euler("zyx", 0.3 * np.sin(np.outer(np.arange(600) / RATE_HZ, [1.1, 1.7, 2.3])))


def recording_of(turns, seed=1, array=ARRAY):
    """Return six seconds of an array that is turned beside the coil."""
    time_s, matrix = np.arange(600) / RATE_HZ, turns.as_matrix()
    source = COIL.field_T(np.einsum("nij,kj->nki", matrix, array.positions_m))
    world = EARTH_T + np.sin(2 * np.pi * FREQUENCY_HZ * time_s + 0.7)[:, None, None] * source
    noise = 1e-9 * np.random.default_rng(seed).normal(size=source.shape)
    return Recording(time_s, np.einsum("nji,nkj->nki", matrix, world) + noise, attitude=turns.as_quat())


def located(recording, frequency_hz=FREQUENCY_HZ):
    """Return the survey."""
    return locate_alternating(recording, calibration_of(ARRAY), frequency_hz)


def assert_at_the_coil(position_m, covariance_m2):
    """Check that a place is the coil's within five standard errors, and these are no more than centimetres."""
    errors = np.sqrt(np.diagonal(covariance_m2, axis1=-2, axis2=-1))
    assert errors.max() < 0.05
    assert (np.abs(position_m - COIL.position_m) < 5 * errors).all()


@pytest.fixture(scope="module")
def still():
    """Return the survey of three headings whose frequency is stated."""
    return located(recording_of(STILL))


@pytest.fixture
def dipoles_alone(monkeypatch):
    """Leave out the fits of other kinds of sources, which take most of the time and change nothing in a dipole's."""
    monkeypatch.setattr(alternating, "SOURCES", (DIPOLE_INDEX,))


def test_headings_make_one_source_of_all_that_is_read(still):
    """Of three headings 36 readings less six unknowns are free, and each is told with its middle."""
    survey = still
    assert survey.frame == WORLD_FRAME and survey.note.startswith("A coil counts as a point")
    assert_allclose(survey.time_s, [0.995, 2.995, 4.995], atol=0.01)
    assert survey.overall.degrees_of_freedom == 30
    assert_at_the_coil(survey.overall.position_m, survey.overall.position_covariance_m2)
    assert (
        np.linalg.eigvalsh(survey.solutions.position_covariance_m2 - survey.overall.position_covariance_m2) > 0
    ).all()


def test_standard_errors_of_the_headings_and_of_all_are_honest(dipoles_alone):
    """The squared errors over their covariance are χ² of three, for each heading and for all together."""
    runs, each, overall, fit = 10, [], [], []
    for seed in range(runs):
        survey = located(recording_of(STILL, seed))
        assert survey.solutions.is_located.all() and len(survey.time_s) == 3
        off = survey.solutions.position_m - COIL.position_m
        each.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(survey.solutions.position_covariance_m2), off))
        rest = survey.overall.position_m - COIL.position_m
        overall.append(rest @ np.linalg.inv(survey.overall.position_covariance_m2) @ rest)
        fit.append(survey.overall.chi_square / survey.overall.degrees_of_freedom)
    for values, count in ((np.concatenate(each), 3 * runs), (np.array(overall), runs)):
        assert np.mean(values) == pytest.approx(3, abs=4 * np.sqrt(6 / count))
    assert np.mean(fit) == pytest.approx(1, abs=4 * np.sqrt(2 / 6 / runs))


def test_the_moments_of_headings_are_turned_to_one_side(still):
    """The sign of each heading is open; the mean has the true moment or its opposite."""
    moment = still.overall.moment_Am2
    assert np.abs(moment) == pytest.approx(np.abs(COIL.moment_Am2), rel=0.02)
    assert np.sign(moment @ COIL.moment_Am2) * (moment @ COIL.moment_Am2) > 0.99 * COIL.moment_Am2 @ COIL.moment_Am2


def test_one_sensor_cannot_locate():
    """Without a gradient both kinds of source are refused in one sentence."""
    single = Array(np.zeros((1, 3)), np.array([1e-9]))
    recording = recording_of(STILL, array=single)
    for locate in (locate_alternating, locate_steady):
        with pytest.raises(InputError, match="no gradient"):
            locate(recording, calibration_of(single))


def test_one_pose_is_no_mean(dipoles_alone):
    """What is told of all together would be that of the one."""
    assert located(recording_of(STILL).take(slice(200))).overall is None


def test_without_an_attitude_the_source_is_in_the_array_frame(dipoles_alone):
    """One pose, in the middle of the record; the array is not turned."""
    still = recording_of(Rotation.from_euler("z", np.zeros((600, 1))))
    survey = located(replace(still, attitude=None))
    assert survey.frame == ARRAY_FRAME and survey.overall is None
    assert_allclose(survey.time_s, [2.995])
    assert_at_the_coil(survey.solutions.position_m, survey.solutions.position_covariance_m2)


def test_samples_without_an_attitude_are_left_out(dipoles_alone):
    """They count for nothing, whatever they read."""
    recording = recording_of(STILL)
    attitude, readings = recording.attitude.copy(), recording.readings_T.copy()
    attitude[150:230], readings[150:230] = np.nan, 1e-3
    survey = located(replace(recording, readings_T=readings, attitude=attitude))
    assert_at_the_coil(survey.overall.position_m, survey.overall.position_covariance_m2)
    assert_allclose(survey.time_s[0], 0.745, atol=0.01)


def test_an_array_that_never_stands_still_locates_as_it_turns(dipoles_alone):
    """Field and gradient are demodulated in the world; the error of finite baselines is told."""
    survey = located(recording_of(SWAYING))
    assert survey.frame == WORLD_FRAME and "never stood still" in survey.note
    assert_allclose(survey.time_s, [2.995])
    assert survey.solutions.is_located.tolist() == [True]
    off = survey.solutions.position_m[0] - COIL.position_m
    assert np.linalg.norm(off) < (0.5 / np.linalg.norm(COIL.position_m)) ** 2 * np.linalg.norm(COIL.position_m)


def test_the_line_is_found_or_stated(still, dipoles_alone):
    """A stated frequency has no standard error; the spectrum reaches from ten periods to half the sampling rate."""
    line = located(recording_of(STILL), None).line
    assert np.isnan(still.line.standard_error_hz) and line.standard_error_hz > 0
    assert line.frequency_hz == pytest.approx(FREQUENCY_HZ, abs=0.01) and still.line.frequency_hz == FREQUENCY_HZ
    searched = line.spectrum.frequency_hz
    step = searched[1] - searched[0]
    assert 0 <= searched[0] - 10 / 5.99 < step < 0.05
    assert 0 <= RATE_HZ / 2 - searched[-1] < step


@pytest.mark.parametrize(
    ("frequency_hz", "reason"), [(None, "line"), (FREQUENCY_HZ, "the field of the source is zero")]
)
def test_noise_alone_is_refused(frequency_hz, reason):
    """As no line stands out of it; at a frequency that is stated as no field does."""
    quiet = recording_of(STILL)
    noise = 1e-9 * np.random.default_rng(2).normal(size=quiet.readings_T.shape)
    with pytest.raises(Refused, match=reason):
        located(replace(quiet, readings_T=EARTH_T + noise), frequency_hz)


@pytest.mark.parametrize("frequency_hz", [0.0, -10.0, np.nan, np.inf])
def test_a_frequency_is_a_positive_number(frequency_hz):
    """Anything else is refused by name."""
    with pytest.raises(InputError, match="positive number of hertz"):
        located(recording_of(STILL), frequency_hz)


TIME_S = np.arange(800) / 100
SIZES = np.array([3.0, -1.0, 0.5, 2.0])


def stretch(hertz=10.0, phases=0.0, noise=0.01, seed=1, part=slice(None)):
    """Return four channels of a source with noise."""
    time = TIME_S[part]
    signal = SIZES * np.sin(2 * np.pi * hertz * time[:, None] + 0.3 + phases)
    noise = noise * np.random.default_rng(seed).normal(size=signal.shape)
    return Stretch(time, signal + noise, background_of(time))


def test_a_stated_frequency_that_is_true_stays():
    """In all but one of a thousand recordings."""
    assert sum(frequency_of([stretch(seed=seed)], 10.0, True) == 10.0 for seed in range(30)) >= 29


def test_a_stated_frequency_that_is_off_is_refused_with_the_true_one():
    """By a fiftieth of a hertz the phase advances by 57° in eight seconds."""
    with pytest.raises(Refused, match=r"the phase advances by 57\.\d° in 7\.99 s\. State 10\.02 Hz"):
        frequency_of([stretch(10.02)], 10.0, True)
    assert frequency_of([stretch(10.02)], 10.0, False) == pytest.approx(10.02, abs=1e-4)


def test_a_stated_frequency_that_was_rounded_is_found():
    """A thousandth of a hertz matters and is no mistake."""
    assert frequency_of([stretch(10.001)], 10.0, True) == pytest.approx(10.001, abs=1e-4)


def test_poses_need_not_keep_their_phase():
    """A source that is switched between two stretches has one frequency."""
    parts = [stretch(part=slice(400)), stretch(phases=1.0, part=slice(400, 800))]
    assert frequency_of(parts, 10.0, True) == 10.0


def test_noise_has_no_frequency():
    """The stated one stays."""
    quiet = stretch(noise=0.0)
    noise = np.random.default_rng(3).normal(size=quiet.channels.shape)
    assert frequency_of([Stretch(TIME_S, noise, quiet.background)], 10.0, True) == 10.0


def test_one_phase_is_one_source():
    """All channels together, in several stretches of other phases."""
    require_one_phase([demodulate(stretch(phases=phase), 10.0) for phase in (0.0, 1.0)])


def test_two_phases_are_two_sources():
    """A channel that is 0.1 rad behind the others is refused; 0.1 mrad of the clocks is not, whatever the noise."""
    with pytest.raises(Refused, match="there are two sources, or the sensors' clocks differ"):
        require_one_phase([demodulate(stretch(phases=np.array([0, 0, 0, 0.1])), 10.0)])
    require_one_phase([demodulate(stretch(phases=np.array([0, 0, 0, 1e-4]), noise=1e-7), 10.0)])


def test_the_estimator_makes_the_amplitudes_that_turn():
    """Field and gradient that rest in the world, as demodulation finds them, with the covariance of their noise."""
    turns = Rotation.from_euler("zyx", 0.4 * np.sin(np.outer(TIME_S, [1.1, 1.7, 2.3])))
    turning, background = turning_of(turns.as_quat()), background_of(TIME_S, turns.as_quat())
    truth = np.array([1.0, -2, 3, 0.5, 1, -1, 2, 0.3])
    swing = np.sin(2 * np.pi * 10 * TIME_S)[:, None]
    found = []
    for seed in range(30):
        noise = 0.1 * np.random.default_rng(seed).normal(size=(800, 8))
        own = Stretch(TIME_S, swing * (turning @ truth) + noise, background, turning)
        _, estimator, covariance = estimator_of(own, demodulate(own, 10.0))
        found.append(np.einsum("onp,np->o", estimator, own.channels))
    pulls = (np.array(found) - truth) / np.sqrt(np.diag(covariance))
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1, abs=0.15)
