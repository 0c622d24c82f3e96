"""What all samples of a run share: found with its standard errors, whatever the places, and white in what is left."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from passed_runs import ARRAY, NOISE, PATH_M, TRUE_T, dipole, line, passed

from tam_calibration.localization.shared_source import fit_shared
from tam_calibration.localization.turned_samples import Regional, Samples, locate_samples, turned

SPREAD_T2 = 25e-18 * np.array([[2.0, 0.5, 0.0], [0.5, 1.0, -0.3], [0.0, -0.3, 1.5]])


def shared_of(seed, source, index, attitude_noise=0.0, field_T=TRUE_T, spread_T2=SPREAD_T2):
    """Return what is shared by the samples that are located beside a field that is off as much as is stated."""
    outputs, attitude = passed(seed, [source], attitude_noise)
    prior = Regional(field_T, attitude_noise, spread_T2)
    samples = Samples(outputs, ARRAY, NOISE, attitude, index)
    own = locate_samples(samples, prior)
    world = turned(own, attitude, attitude_noise)
    at = np.flatnonzero(world.is_located)
    return at, fit_shared(samples.take(at), world.take(at), prior, prior)


@pytest.mark.parametrize(("source", "index", "noise"), [(dipole(), 3, 0.0), (dipole(8.0), 3, 2e-4), (line(2), 2, 0.0)])
def test_it_is_found_with_its_standard_errors(source, index, noise):
    """χ² is what noise leaves, and the regional field is off by its standard errors, a part of the prior's."""
    chi_square, freedom, pulls = 0.0, 0, []
    for seed in range(6):
        off = np.random.default_rng(seed + 100).multivariate_normal(np.zeros(3), SPREAD_T2 * 1e18) / 1e9
        at, shared = shared_of(seed, source, index, noise, TRUE_T + off)
        assert shared.solution.is_found[0]
        chi_square += np.sum(shared.residuals**2)
        freedom += shared.freedom * len(at) - shared.slopes.shape[2] + 3
        error = shared.regional.field_T - TRUE_T
        pulls.append(error @ np.linalg.solve(shared.regional.covariance_T2, error))
        if not noise:
            assert np.trace(shared.regional.covariance_T2) < 0.05 * np.trace(SPREAD_T2)
    assert abs(chi_square - freedom) < 4 * np.sqrt(2 * freedom)
    assert 1 < np.mean(pulls) < 6


def test_places_are_those_of_the_source():
    """Of a dipole in all three directions, of a line across it, more exactly than each sample by itself has them."""
    at, shared = shared_of(1, dipole(), 3)
    assert_allclose(shared.position_m + PATH_M[at], np.tile(dipole().position_m, (len(at), 1)), atol=0.1)
    assert_allclose(shared.across, np.eye(3))
    at, shared = shared_of(1, line(2), 2)
    off = shared.position_m + PATH_M[at] - line(2).position_m
    assert_allclose(shared.across.T @ [0.0, 1.0, 0.0], 0.0, atol=0.01)
    assert_allclose(off[:, [0, 2]], 0.0, atol=0.1)
    assert_allclose(shared.position_m[:, 1], 0.0, atol=0.2)


def test_an_exact_field_is_not_fitted():
    """Its covariance stays zero, and what is shared is the moment alone."""
    _, shared = shared_of(2, dipole(), 3, spread_T2=np.zeros((3, 3)))
    assert not shared.regional.covariance_T2.any()
    assert_allclose(shared.regional.field_T, TRUE_T)
    assert not shared.slopes[..., 3:].any() and not shared.solution.unknowns[0, 3:].any()
    assert_allclose(shared.solution.unknowns[0, :3], dipole().moment_Am2, rtol=0.02)


def test_what_is_left_is_at_right_angles_to_the_places():
    """The derivatives by what is shared keep five numbers of each sample of a dipole."""
    _, shared = shared_of(3, dipole(), 3)
    ranks = np.linalg.matrix_rank(np.concatenate([shared.slopes, shared.residuals[..., None]], axis=2), tol=1e-6)
    assert (ranks <= shared.freedom).all() and shared.freedom == 5
