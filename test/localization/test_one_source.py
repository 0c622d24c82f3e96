"""A run is located beside the field that its samples need, or refused where they are not those of one source."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from passed_runs import ARRAY, NOISE, PATH_M, TRUE_T, course, dipole, line, passed

from tam_calibration.localization import locate as run_of_samples
from tam_calibration.localization import shared_source, source_fit
from tam_calibration.localization.locate import _is_apart, locate_run
from tam_calibration.localization.shared_source import SharedSource
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.turned_samples import Regional, Samples, locate_each, locate_samples, regional_of
from tam_calibration.model.exceptions import Refused

KNOWN = Regional(TRUE_T + 60e-9, covariance_T2=100e-9**2 * np.eye(3))
NEAR = Regional(TRUE_T + 5e-9, covariance_T2=10e-9**2 * np.eye(3))
ALIKE = r"not those of one .* at rest beside a uniform regional field: what is left is \d+\.?\d* times the noise"


def located(sources, index=3, seed=1, known=None, attitude_noise=0.0, gradient_T_per_m=0.0):
    """Return the samples of a run, and the field beside them."""
    outputs, attitude = passed(seed, sources, attitude_noise, gradient_T_per_m)
    prior = regional_of(outputs, attitude, attitude_noise) if known is None else known
    return locate_run(Samples(outputs, ARRAY, NOISE, attitude, index), prior)


@pytest.mark.parametrize(("source", "index"), [(dipole(), 3), (line(1), 1), (line(2), 2)])
def test_the_samples_tell_the_field_beside_their_source(source, index):
    """Known to 100 nT it is found to 2 nT and better, and places have the errors they are said to have."""
    pulls = []
    for seed in range(2):
        world, regional = located([source], index, seed, None if index == 1 else KNOWN)
        errors = np.sqrt(np.diag(regional.covariance_T2))
        assert errors.max() < 2e-9
        assert np.abs((regional.field_T - TRUE_T) / errors).max() < 4
        at = world.is_located
        assert at.sum() > 20
        off = world.position_m[at] + PATH_M[at] - source.position_m
        spread = np.sqrt(np.diagonal(world.position_covariance_m2[at], axis1=1, axis2=2))
        pulls.append((off / spread)[:, [0, 2]])
    assert 0.91 < np.mean(np.abs(np.concatenate(pulls)) < 1.96) < 0.98
    assert np.abs(np.concatenate(pulls)).max() < 5


def test_more_samples_are_located_beside_the_field_that_is_found():
    """Than beside a field that is known to 100 nT."""
    outputs, attitude = passed(1, [line(2)])
    before = locate_samples(Samples(outputs, ARRAY, NOISE, attitude, 2), KNOWN)
    world, _ = locate_run(Samples(outputs, ARRAY, NOISE, attitude, 2), KNOWN)
    assert world.is_located.sum() > before.is_located.sum() + 10


@pytest.mark.parametrize(
    ("sources", "index", "known"),
    [
        ([dipole(), dipole(0.02, (3.0, 3.0, -2.0))], 3, NEAR),
        ([line(1), line(1, (4.0, 0.0, -2.5))], 1, None),
        ([line(2), line(2, (2.0, 0.0, -2.5))], 2, KNOWN),
    ],
)
def test_a_second_source_is_seen(sources, index, known):
    """A dipole of 4 A m² beside one of 200, and a second line, leave more than noise."""
    with pytest.raises(Refused, match=r"not those of one .* uniform regional field|too few to tell one source"):
        located(sources, index, known=known)


@pytest.mark.parametrize(("source", "index", "known"), [(dipole(), 3, NEAR), (line(1), 1, None), (line(2), 2, NEAR)])
def test_a_gradient_of_the_regional_field_is_seen(source, index, known):
    """0.3 nT/m, of which the samples by themselves leave no more than noise, are slow along the run."""
    with pytest.raises(Refused, match=ALIKE + ", where it is slow"):
        located([source], index, known=known, gradient_T_per_m=0.3e-9)


def test_errors_of_the_attitude_are_no_second_source():
    """Those of a dipole that is strong enough to be located beside them."""
    known = replace(KNOWN, attitude_noise=2e-4)
    world, regional = located([dipole(8.0)], known=known, attitude_noise=2e-4, seed=3)
    assert world.is_located.sum() > 20
    assert regional.attitude_noise == 2e-4


def test_an_exact_field_stays_what_it_is():
    """Its covariance stays away."""
    world, regional = located([dipole()], known=Regional(TRUE_T))
    assert world.is_located.sum() > 20 and not regional.covariance_T2.any()
    with pytest.raises(Refused, match="what is left"):
        located([dipole()], known=Regional(TRUE_T + 1e-9))


def test_few_samples_tell_no_source_from_several():
    """Ten that are located are needed; where there is none each has its own reason."""
    outputs, attitude = passed(5, [dipole()])
    for count, is_told in ((10, True), (9, False)):
        near = slice(30 - count // 2, 30 - count // 2 + count)
        run = (Samples(outputs[near], ARRAY, NOISE, attitude[near]), Regional(TRUE_T))
        if is_told:
            assert locate_run(*run)[0].is_located.all()
            continue
        with pytest.raises(Refused, match=r"only 9 samples are located, too few .* 10 are needed"):
            locate_run(*run)
    world, _ = located([])
    assert not world.is_located.any()


def test_of_a_run_without_a_current_no_sample_is_located():
    """And the regional field stays where it is."""
    outputs, attitude = passed(4, [])
    world, found = locate_run(Samples(outputs, ARRAY, NOISE, attitude, 1), NEAR)
    assert not world.is_located.any()
    assert_array_equal(found.field_T, NEAR.field_T)


@pytest.mark.parametrize(("across", "limit"), [(np.eye(3), 4.033), (np.eye(3)[:, :2], 3.717)])
def test_a_sample_with_another_solution_is_told(across, limit):
    """χ² of three or two numbers at its 99.9 % point; along a line places do not count."""
    own = EulerSolutions.refused(4, Status.LOCATED)
    own.position_m[:] = [[limit - 0.01, 0, 0], [limit + 0.01, 0, 0], [0, -limit - 0.01, 0], [0, 0, 0.5]]
    own.position_m[:] *= 0.1
    own.position_covariance_m2[:] = 0.01 * np.eye(3)
    nothing = np.zeros(0)
    shared = SharedSource(None, np.zeros((4, 3)), across, Regional(TRUE_T), nothing, nothing, 8 - across.shape[1])
    assert _is_apart(own, shared).tolist() == [False, True, True, False]


@pytest.fixture(scope="module")
def beside_a_dipole():
    """Return the field that is found beside a dipole."""
    return located([dipole()], known=NEAR)[1]


@pytest.mark.parametrize(
    ("module", "name", "value"),
    [
        (run_of_samples, "MOST_STEPS", 100),
        (run_of_samples, "SETTLED", 0.01),
        (source_fit, "SMALLEST_STEP", 1e-7),
        (shared_source, "SMALLEST_STEP", 1e-16),
    ],
)
def test_what_is_found_does_not_depend_on_when_steps_end(beside_a_dipole, monkeypatch, module, name, value):
    """To a thousandth of the standard errors."""
    before = beside_a_dipole
    monkeypatch.setattr(module, name, value)
    _, after = located([dipole()], known=NEAR)
    errors = np.sqrt(np.diag(before.covariance_T2))
    assert np.abs((after.field_T - before.field_T) / errors).max() < 1e-3


def test_a_field_that_does_not_settle_is_refused(monkeypatch):
    """Two rounds are not enough from a field that is off by hundreds of times the noise."""
    monkeypatch.setattr(run_of_samples, "MOST_STEPS", 2)
    with pytest.raises(Refused, match="no source explains all of them"):
        located([dipole()], known=KNOWN)


def test_a_sample_with_another_solution_is_refused_in_its_run(monkeypatch):
    """Its place is six standard errors from where all samples have it; the others stay what they are."""

    def elsewhere(*given):
        found = locate_each(*given)
        found.position_m[30] += 6 * np.sqrt(np.diag(found.position_covariance_m2[30]))
        return found

    before, _ = located([dipole()], known=Regional(TRUE_T))
    monkeypatch.setattr(run_of_samples, "locate_each", elsewhere)
    after, _ = located([dipole()], known=Regional(TRUE_T))
    assert before.status[30] == Status.LOCATED and after.status[30] == Status.APART
    assert np.array_equal(np.delete(before.status, 30), np.delete(after.status, 30))


def test_what_is_known_of_the_field_counts_as_much_as_it_is_certain(beside_a_dipole):
    """Known to a tenth of what the samples tell, it stays where it is stated, within that."""
    outputs, attitude = passed(1, [dipole()])
    told = beside_a_dipole
    error = 0.1 * np.sqrt(np.diag(told.covariance_T2))
    stated = told.field_T + 10 * error
    _, found = locate_run(Samples(outputs, ARRAY, NOISE, attitude), Regional(stated, covariance_T2=np.diag(error**2)))
    assert (np.abs(found.field_T - stated) < 2 * error).all()


def test_a_long_run_of_one_dipole_is_one():
    """Thousands of samples have errors of second order alike, which all of them together would see."""
    outputs, attitude = passed(1, [dipole()], path_and_sway=course(6000, 30.0))
    world, regional = locate_run(
        Samples(outputs, ARRAY, NOISE, attitude), Regional(TRUE_T, covariance_T2=1e-20 * np.eye(3))
    )
    assert world.is_located.sum() > 2000
    assert np.abs((regional.field_T - TRUE_T) / np.sqrt(np.diag(regional.covariance_T2))).max() < 4
