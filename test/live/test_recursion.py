"""The recursion over blocks of samples, against the fit of all of them together."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import UNCHANGING, ashore, dive, moved, recording_of
from numpy.testing import assert_allclose

from tam_calibration.core.noise import VarianceFactors
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.problem import Known, posterior_of
from tam_calibration.live.recursion import LARGEST_WALK, Belief, MomentLikelihood, Recursion, SampleMoments, Walk
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors


def learned(prior, rows, size):
    """Return the recursion after all rows, in blocks of a size."""
    likelihood = MomentLikelihood(prior.errors, prior.calibration.array, prior.calibration.intensity_T)
    recursion = Recursion.at(Belief(prior.errors, prior.covariance, rows[0, 0], np.nan))
    for block in np.split(rows, range(size, len(rows), size)):
        moments = likelihood.moments(block[:, 1:-2].reshape(len(block), -1, 3), block[:, -2])
        recursion = recursion.after(moments, block[-1, 0], np.nan, likelihood, Walk(prior))
    return recursion


@pytest.fixture(scope="module")
def far_prior(true_errors, cross):
    """Return a prior from which one bias is 200 of its standard errors away, and that prior's truth now."""
    prior = ashore(true_errors, cross, np.random.default_rng(1), UNCHANGING)
    variance = np.zeros((4, 12))
    variance[1, 6:9] = 100e-9**2
    prior = replace(prior, covariance=prior.covariance + np.diag(variance.ravel()))
    return prior, moved(true_errors, 2, bias_T=np.array([120e-9, -80e-9, 60e-9]))


@pytest.mark.parametrize("size", [50, 199])
def test_blocks_one_after_another_give_the_fit_of_all_samples(far_prior, cross, size):
    """To a hundredth of the standard errors, whatever the size of the blocks, after a bias that moved by hundreds."""
    prior, errors = far_prior
    rows = dive(errors, cross, np.random.default_rng(2), np.arange(3000) / 20)
    rows[::7, -2] = np.nan
    batch = posterior_of(recording_of(rows), prior.calibration.array, Known(prior))
    now = learned(prior, rows, size).now
    assert now.distance(batch.errors) < 0.01
    deviations = np.sqrt(np.diag(batch.covariance))
    assert_allclose(np.sqrt(np.diag(now.covariance)), deviations, rtol=1e-3, atol=1e-15)


def test_the_moments_give_the_normal_equations_of_the_samples(far_prior, cross):
    """At errors far from those that the moments are about: information, gradient and energies as from the samples.

    So is the common mode's part of them; factors weigh each channel.
    """
    prior, errors = far_prior
    array, unit_T = prior.calibration.array, prior.calibration.intensity_T
    rows = dive(errors, cross, np.random.default_rng(3), np.arange(1000) / 20)
    recording = recording_of(rows)
    likelihood = MomentLikelihood(prior.errors, array, unit_T)
    halves = [
        likelihood.moments(recording.readings_T[part], recording.scalar_T[part])
        for part in (slice(400), slice(400, None))
    ]
    here = likelihood.linearize(halves[0] + halves[1], errors)
    data = Normalized(recording, prior.errors.bias_T, unit_T, has_scalar=True)
    exact = Likelihood(data, array.vector_noise_T / unit_T, array.scalar_noise_T / unit_T).linearize(
        errors.matrix, (errors.bias_T - prior.errors.bias_T) / unit_T
    )
    jacobian = np.zeros((4, 12, 4, 12))
    for sensor, block in enumerate(errors.jacobian() * np.array([1, 1, 1, 1 / unit_T])[:, None]):
        jacobian[sensor, :, sensor] = block.reshape(12, 12)
    jacobian = jacobian.reshape(48, 48)
    scale = np.sqrt(np.diag(here.both.information))
    difference = (here.both.information - jacobian.T @ exact.both.information @ jacobian) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-3
    assert np.abs((here.both.score - jacobian.T @ exact.both.score) / scale).max() < 1e-2
    difference = (here.common.information - jacobian.T @ exact.common.information @ jacobian) / np.outer(scale, scale)
    assert np.abs(difference).max() < 1e-3
    assert np.abs((here.common.score - jacobian.T @ exact.common.score) / scale).max() < 1e-2
    assert_allclose([here.between.energy, here.common.energy], [exact.between.energy, exact.common.energy], rtol=1e-3)
    assert here.common.count == 1000
    factors = VarianceFactors(4.0, 90.0)
    weighed = replace(likelihood, factors=factors).linearize(halves[0] + halves[1], errors)
    assert weighed.both.information.tolist() == here.weighed(factors).both.information.tolist()


def test_what_changes_is_forgotten_as_in_a_kalman_filter(true_errors, cross):
    """With rates that make every block a stretch of its own, and no motion, the bias's variance is the steady one."""
    rate_T = 20e-9
    rates = replace(UNCHANGING, bias_per_day=rate_T * np.sqrt(86_400.0))
    prior = ashore(true_errors, cross, np.random.default_rng(4), rates)
    rows = dive(true_errors, cross, np.random.default_rng(5), np.arange(2000) / 10)
    now = learned(prior, rows, 20).now
    # Between sensors: twice the walk of one, read with twice its noise; P = (q + √(q² + 4 q r)) / 2, then with r.
    pair = np.zeros((4, 12))
    pair[1, 6], pair[3, 6] = 1.0, -1.0
    walk, noise = 2 * rate_T**2 * 2.0, 2 * cross.vector_noise_T[0] ** 2 / 20
    before = (walk + np.sqrt(walk**2 + 4 * walk * noise)) / 2
    variance = float(pair.ravel() @ now.covariance @ pair.ravel())
    assert variance == pytest.approx(before * noise / (before + noise), rel=0.1)
    assert LARGEST_WALK < 1


def test_a_stretch_ends_when_the_walk_is_no_longer_small(true_errors, cross):
    """Without changes one stretch holds all samples; with the default rates the sum of its moments stays small."""
    generator = np.random.default_rng(6)
    rows = dive(true_errors, cross, generator, np.arange(2000) / 10)
    still = learned(ashore(true_errors, cross, generator, UNCHANGING), rows, 20)
    walking = learned(ashore(true_errors, cross, generator, replace(ChangeRates(), bias_per_day=50e-9)), rows, 20)
    assert still.moments.count == 2000
    assert 0 < walking.moments.count < 1000
    nothing = SampleMoments.none(4)
    assert (nothing.count, nothing.scalar_count) == (0, 0)


def test_noise_does_not_pull_what_a_narrow_swing_hardly_determines(true_errors, cross):
    """Moments of readings with 30 nT of noise, settled upon, give the errors of maximum likelihood on the samples."""
    noisy = replace(cross, vector_noise_T=np.full(4, 30e-9), scalar_noise_T=3e-9)
    rows = dive(true_errors, noisy, np.random.default_rng(4), np.arange(10_000) / 20)
    batch = maximum_likelihood(recording_of(rows), noisy)
    likelihood = MomentLikelihood(batch.errors, noisy, batch.intensity_T)
    recording = recording_of(rows)
    moments = likelihood.moments(recording.readings_T, recording.scalar_T)
    gradient = likelihood.linearize(moments, batch.errors).both.score
    # The covariance times the score is the step to where the moments have their most probable errors.
    step = np.abs(batch.covariance @ gradient)
    assert np.all(step < 0.02 * batch.standard_errors.ravel() + 1e-18)


def test_a_belief_has_changed_by_its_errors_or_its_standard_errors(far_prior):
    """Twice the standard errors are a change by one of them, half of them by a half; a step by its own size."""
    prior, _ = far_prior
    belief = Belief(prior.errors, prior.covariance, 0.0, np.nan)
    for factor, change in ((1.0, 0.0), (2.0, 1.0), (0.5, 0.5)):
        assert belief.change_to(replace(belief, covariance=factor**2 * belief.covariance)) == pytest.approx(change)
    step = 3 * np.sqrt(np.diag(prior.covariance)).reshape(4, 12)
    moved_errors = SensorErrors.from_vector(prior.errors.to_vector() + step)
    free = np.diag(prior.covariance) > 0
    inverse = np.linalg.inv(prior.covariance[np.ix_(free, free)] * 1e18) * 1e18
    assert belief.distance(moved_errors) == pytest.approx(
        np.sqrt(step.ravel()[free] @ inverse @ step.ravel()[free] / 45)
    )
    assert belief.change_to(replace(belief, errors=moved_errors)) == pytest.approx(belief.distance(moved_errors))


def test_what_changes_since_a_belief_asks_for_the_time_between(true_errors, cross):
    """The same after a day from any stamp on; nothing where stamps go back."""
    prior = ashore(true_errors, cross, np.random.default_rng(7), ChangeRates())
    walk, belief = Walk(prior), Belief(prior.errors, prior.covariance, 1.7e9, np.nan)
    day = walk.covariance(belief, belief.time_s + DAY_S, np.nan)
    assert_allclose(day, walk.covariance(replace(belief, time_s=0.0), DAY_S, np.nan))
    assert day[12 + 6, 12 + 6] == pytest.approx(ChangeRates().variances(DAY_S, 0.0)[6])
    assert not walk.covariance(belief, belief.time_s - DAY_S, np.nan).any()


def test_what_the_prior_holds_does_not_change(true_errors, cross):
    """A bias that is known for certain stays so, however its sensor drifts."""
    prior = ashore(true_errors, cross, np.random.default_rng(8), ChangeRates())
    covariance = prior.covariance.copy()
    covariance[18:21], covariance[:, 18:21] = 0, 0
    walk = Walk(replace(prior, covariance=covariance))
    change = walk.covariance(Belief(prior.errors, covariance, 0.0, np.nan), DAY_S, np.nan)
    assert not change[18:21].any() and (np.diag(change)[12:18] > 0).all()
    assert not walk.kept(np.eye(48))[18:21].any()


def test_a_temperature_that_is_not_known_is_the_last_one_that_was(true_errors, cross):
    """Of blocks with a temperature, with another, and without."""
    prior = ashore(true_errors, cross, np.random.default_rng(9))
    likelihood = MomentLikelihood(prior.errors, prior.calibration.array, prior.calibration.intensity_T)
    recursion = Recursion.at(Belief(prior.errors, prior.covariance, 0.0, 10.0))
    rows = dive(true_errors, cross, np.random.default_rng(9), np.arange(90) / 10)
    told = []
    for block, temperature_C in zip(np.split(rows, 3), (11.0, 12.0, np.nan), strict=True):
        moments = likelihood.moments(block[:, 1:-2].reshape(len(block), -1, 3), block[:, -2])
        recursion = recursion.after(moments, block[-1, 0], temperature_C, likelihood, Walk(prior))
        told.append(recursion.now.temperature_C)
    assert told == [11.0, 12.0, 12.0]


def test_steps_to_sensors_that_cannot_be_are_refused(far_prior, cross):
    """A sensor whose driver reverses its axes, where its scale factors may be any: it is said, and is no traceback."""
    prior, errors = far_prior
    variance = np.zeros((4, 12))
    variance[1, :3] = 100.0
    rows = dive(errors, cross, np.random.default_rng(8), np.arange(400) / 20)
    rows[:, 4:7] *= -1
    with pytest.raises(Refused, match="sensors that cannot be: the readings do not fit the calibration"):
        learned(replace(prior, covariance=prior.covariance + np.diag(variance.ravel())), rows, 200)
