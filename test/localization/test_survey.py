"""What a survey tells: its standard errors are honest, and a survey without a source is refused."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization import alternating
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.locate import locate_steady
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.survey import WORLD_FRAME, Survey, standard_errors
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.residuals import noise_floor
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.sources.dipole import Dipole

EARTH_T = np.array([1e-6, 21e-6, -43e-6])
NOISE_T = 1e-9
COIL = Dipole(np.array([2.4, -1.0, 0.46]), np.array([30.0, -20.0, 25.0]))
RUNS = 10


def perfect(array):
    """Return the calibration of an array without errors, known exactly."""
    errors = SensorErrors.none(array.sensor_count)
    floor = noise_floor(errors, array, 1e-10)
    return Calibration(
        "maximum_likelihood", array, False, errors, None, True, 48e-6, floor, floor, floor, 100, (0.0, 1.0), 1.0
    )


@pytest.fixture
def cross():
    """Return an array of 0.5 m."""
    return Array.cross(0.5, NOISE_T, 1e-10)


def headings(array, seed):
    """Return the recording of the coil at 10 Hz in three headings of two seconds."""
    time = np.arange(600) / 100
    turns = Rotation.from_euler("z", np.repeat(np.arange(3), 200)[:, None])
    matrix = turns.as_matrix()
    source = COIL.field_T(np.einsum("nij,kj->nki", matrix, array.positions_m))
    world = EARTH_T + np.sin(2 * np.pi * 10 * time + 0.7)[:, None, None] * source
    noise = NOISE_T * np.random.default_rng(seed).normal(size=source.shape)
    return Recording(time, np.einsum("nji,nkj->nki", matrix, world) + noise, attitude=turns.as_quat())


def test_standard_errors_of_the_headings_and_of_all_are_honest(cross, monkeypatch):
    """The squared errors over their covariance are χ² of three, for each heading and for all together.

    Fits of the other kinds of sources, which take most of the time, are left out: they change nothing in these.
    """
    monkeypatch.setattr(alternating, "SOURCES", (DIPOLE_INDEX,))
    each, overall, fit = [], [], []
    for seed in range(RUNS):
        survey = locate_alternating(headings(cross, seed), perfect(cross), 10.0)
        assert survey.solutions.is_located.all() and len(survey.time_s) == 3
        off = survey.solutions.position_m - COIL.position_m
        each.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(survey.solutions.position_covariance_m2), off))
        rest = survey.overall.position_m - COIL.position_m
        overall.append(rest @ np.linalg.inv(survey.overall.position_covariance_m2) @ rest)
        fit.append(survey.overall.chi_square / survey.overall.degrees_of_freedom)
    for values, count in ((np.concatenate(each), 3 * RUNS), (np.array(overall), RUNS)):
        assert np.mean(values) == pytest.approx(3, abs=4 * np.sqrt(6 / count))
    assert np.mean(fit) == pytest.approx(1, abs=4 * np.sqrt(2 / 6 / RUNS))


def test_the_moments_of_headings_are_turned_to_one_side(cross):
    """The sign of each heading is open; the mean has the true moment or its opposite."""
    moment = locate_alternating(headings(cross, 1), perfect(cross), 10.0).overall.moment_Am2
    assert np.abs(moment) == pytest.approx(np.abs(COIL.moment_Am2), rel=0.02)
    assert np.sign(moment @ COIL.moment_Am2) * (moment @ COIL.moment_Am2) > 0.99 * COIL.moment_Am2 @ COIL.moment_Am2


def test_one_sensor_cannot_locate():
    """Without a gradient both kinds of source are refused in one sentence."""
    single = Array(np.zeros((1, 3)), np.array([NOISE_T]))
    recording = headings(single, 1)
    for locate in (locate_alternating, locate_steady):
        with pytest.raises(InputError, match="no gradient"):
            locate(recording, perfect(single))


def test_nothing_located_is_refused_with_the_most_common_reason():
    """A survey has a source, or is none."""
    solutions = EulerSolutions.refused(4, Status.NO_FIELD)
    solutions.status[0] = Status.AMBIGUOUS
    with pytest.raises(Refused, match="in 3 of 4 samples the field of the source is zero"):
        Survey(WORLD_FRAME, np.arange(4.0), solutions, np.zeros((4, 3)))


def test_a_single_sample_is_refused_by_its_own_reason():
    """It is not told as one of one."""
    with pytest.raises(Refused, match="in the sample the gradient tensor is zero"):
        Survey(WORLD_FRAME, np.zeros(1), EulerSolutions.refused(1, Status.NO_GRADIENT), np.zeros((1, 3)))


def test_refusals_are_counted_by_their_reason():
    """Samples that were located are none."""
    solutions = EulerSolutions.refused(5, Status.UNCERTAIN)
    solutions.status[[0, 3]] = Status.LOCATED, Status.AMBIGUOUS
    survey = Survey(WORLD_FRAME, np.arange(5.0), solutions, np.zeros((5, 3)))
    assert survey.refusals == {Status.UNCERTAIN: 3, Status.AMBIGUOUS: 1}


@pytest.mark.parametrize("shape", [(), (4,), (2, 5)])
def test_standard_errors_are_the_roots_of_each_diagonal(shape):
    """Of one covariance, or of as many as there are."""
    roots = np.random.default_rng(4).normal(size=(*shape, 3, 3))
    errors = standard_errors(roots @ np.swapaxes(roots, -1, -2))
    assert errors.shape == (*shape, 3)
    assert errors == pytest.approx(np.sqrt(np.sum(roots**2, axis=-1)))
