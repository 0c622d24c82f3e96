"""Standard errors hold what residuals that last for many samples do to a fit; where these are white they stay."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import chi2

from tam_calibration.fit import calibrate, slow_residuals
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.slow_residuals import variance_factor, widened
from tam_calibration.model.array import Array
from tam_calibration.model.recording import BLOCK
from tam_calibration.simulation import simulate
from tam_calibration.simulation.attitude import Tumble

LASTS = 20
"""Samples that the slow noise lasts for: a twelfth of a block of the recordings."""


def turned(scenario, seed, slow_T=0.0, count=4000):
    """Return a recording of a slow turn, with noise that lasts in each axis beside the white one."""
    scenario = replace(scenario, motion=Tumble(np.radians(20)), sample_count=count, rate_hz=10.0, seed=seed)
    recording = simulate(scenario).recording
    kept = np.exp(-1 / LASTS)
    white = np.random.default_rng([seed, 1]).normal(size=recording.readings_T.shape)
    slow = lfilter([np.sqrt(1 - kept**2)], [1, -kept], white, axis=0)
    return replace(recording, readings_T=recording.readings_T + slow_T * slow)


def fitted(recording, scenario):
    """Return the plain fit with the stated noise."""
    return maximum_likelihood(recording, scenario.array.with_stated_noise())


def pulls(calibration, scenario):
    """Return the errors of all free parameters over their standard errors."""
    error = (calibration.errors.to_vector() - scenario.errors.to_vector()).ravel()
    free = calibration.standard_errors.ravel() > 0
    return error[free] / calibration.standard_errors.ravel()[free]


def test_white_noise_of_the_stated_size_widens_nothing(wu_scenario):
    """In none of 20 runs, where one of a thousand may be; the calibration is then the same to the last bit."""
    for seed in range(20):
        recording = turned(wu_scenario, seed)
        plain = fitted(recording, wu_scenario)
        assert widened(plain, recording).covariance.tolist() == plain.covariance.tolist()


def test_few_samples_of_one_sensor_are_as_seldom_taken_for_slow(wu_scenario):
    """At most one of 150 runs of 16 samples, where one in a thousand is expected: sums of few parameters are no χ²."""
    scenario = replace(wu_scenario, motion=Tumble(np.radians(60)), sample_count=16, rate_hz=1.0)
    array = Array(np.zeros((1, 3)), np.full(1, 1e-9), 1e-10)
    found = []
    for seed in range(150):
        recording = simulate(replace(scenario, seed=seed)).recording
        recording = replace(recording, readings_T=recording.readings_T[:, :1])
        found.append(variance_factor(maximum_likelihood(recording, array), recording))
    assert np.sum(np.array(found) > 1) <= 1


def test_noise_that_lasts_is_in_the_standard_errors(wu_scenario):
    """2 nT that last for 20 samples: 12 runs err by three of white noise's standard errors, and one of theirs."""
    white, slow = [], []
    for seed in range(12):
        recording = turned(wu_scenario, seed, 2e-9)
        plain = fitted(recording, wu_scenario)
        white.append(pulls(plain, wu_scenario))
        slow.append(pulls(widened(plain, recording), wu_scenario))
    assert np.sqrt(np.mean(np.square(white))) > 2.5
    assert 0.85 < np.sqrt(np.mean(np.square(slow))) < 1.15


@pytest.mark.parametrize(("ratio", "is_told"), [(0.96, False), (1.04, True)])
def test_more_than_chance_makes_once_in_a_thousand_is_told(wu_scenario, ratio, is_told):
    """Below and above that point of the χ² of 180 sums, four of 45 parameters: the stated noise scales them."""
    recording, array = turned(wu_scenario, 1), wu_scenario.array.with_stated_noise()
    calibration = maximum_likelihood(recording, array)

    def factor_of(times):
        stated = replace(
            array, vector_noise_T=array.vector_noise_T / times, scalar_noise_T=array.scalar_noise_T / times
        )
        return variance_factor(replace(calibration, array=stated), recording)

    point = chi2.isf(1e-3, 180) / 180
    assert (factor_of(3 * np.sqrt(ratio * point / factor_of(3.0))) > 1) == is_told


@pytest.mark.parametrize("times", [1.3, 3.0])
def test_noise_that_is_larger_than_stated_is_in_the_standard_errors(wu_scenario, times):
    """White noise, so many times the stated: variances are those of its square; 1.3 are 5 deviations from chance."""
    recording = turned(wu_scenario, 1)
    noise = {"vector_noise_T": np.full(4, 1e-9 / times), "scalar_noise_T": 1e-10 / times}
    less = replace(wu_scenario.array.with_stated_noise(), **noise)
    calibration = maximum_likelihood(recording, less)
    assert_allclose(variance_factor(calibration, recording), times**2, rtol=0.25)


def test_blocks_of_the_file_do_not_matter(wu_scenario):
    """A recording of more than one block of samples gives what its own sums give, whatever the bounds."""
    recording = turned(wu_scenario, 2, 2e-9, BLOCK + 1000)
    calibration = fitted(recording, wu_scenario)
    numbers, parts = zip(*slow_residuals._parts(recording), strict=True)
    assert sorted(set(numbers)) == list(range(16))
    assert len(parts) > 16
    assert_allclose(np.concatenate([part.time_s for part in parts]), recording.time_s, rtol=0)
    assert variance_factor(calibration, recording) > 5


def test_too_few_samples_tell_nothing(wu_scenario):
    """Of 15 samples, less than the blocks are, nothing is told; of 16 it is."""
    recording = turned(wu_scenario, 3, 30e-9)
    calibration = fitted(recording, wu_scenario)
    assert variance_factor(calibration, recording.take(slice(15))) == 1.0
    assert variance_factor(calibration, recording.take(slice(16))) > 1.0


@pytest.mark.parametrize("has_scalar", [True, False])
def test_a_calibration_says_by_how_much_they_are_wider(wu_scenario, has_scalar):
    """The factor stands beside the reduced χ², its root in a warning, and the standard errors are wider by it."""
    recording = turned(wu_scenario, 4, 2e-9)
    recording = recording if has_scalar else replace(recording, scalar_T=None)
    plain = fitted(recording, wu_scenario)
    calibration = calibrate(recording, wu_scenario.array.with_stated_noise())
    root = np.sqrt(calibration.variance_factor)
    assert any(f"are {root:.3g} times those of white noise" in one for one in calibration.warnings)
    assert_allclose(calibration.standard_errors, root * plain.standard_errors)


def test_an_update_weighs_slow_residuals_as_what_they_tell(wu_scenario):
    """A turn with 5 nT that last contradicts no prior; taken for white it does, and moves sensors that are at rest."""
    array = wu_scenario.array.with_stated_noise()
    prior = calibrate(turned(wu_scenario, 5), array)
    moved = [calibrate(turned(wu_scenario, seed, 5e-9, 1000), array, prior=prior) for seed in range(6, 12)]
    assert [calibration.update.moved for calibration in moved] == [()] * 6
    assert np.sqrt(np.mean(np.square([pulls(one, wu_scenario) for one in moved]))) < 1.3


def test_an_update_expects_what_was_slow_before(wu_scenario):
    """A prior whose residuals lasted gives its factor to an update of too few samples to show one."""
    array = wu_scenario.array.with_stated_noise()
    prior = calibrate(turned(wu_scenario, 12, 2e-9), array)
    update = calibrate(turned(wu_scenario, 13, 0.0, 15), array, prior=prior, accept=["few_samples"])
    assert update.variance_factor == prior.variance_factor


def test_a_scalar_that_is_silent_for_a_while_makes_nothing_slow(wu_scenario):
    """A fifth of the recording without intensities: white noise stays white, and what moved is found with its size."""
    array = wu_scenario.array.with_stated_noise()
    recording = turned(wu_scenario, 14, count=2000)
    scalar_T, readings_T = recording.scalar_T.copy(), recording.readings_T.copy()
    scalar_T[600:1000] = np.nan
    silent = replace(recording, scalar_T=scalar_T)
    assert calibrate(silent, array).variance_factor == 1
    readings_T[:, 2] += [20e-9, 0, 0]
    update = calibrate(replace(silent, readings_T=readings_T), array, prior=calibrate(turned(wu_scenario, 15), array))
    [moved] = update.update.moved
    assert (moved.kind, moved.sensor) == ("bias", 3) and update.variance_factor == 1
    assert_allclose(moved.change, [20e-9, 0, 0], atol=2e-9)
