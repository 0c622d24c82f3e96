"""Standard errors hold what residuals that last for many samples do to a fit, channel by channel; white ones stay."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import UNCHANGING
from numpy.testing import assert_allclose
from scipy.linalg import eigh
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tam_calibration.core.noise import BLOCKS, COSINES, WHITE, VarianceFactors
from tam_calibration.fit import calibrate, estimate
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.estimate import GROWING, variance_factors, widened
from tam_calibration.fit.information import free_basis, rows_by_unknowns
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.recording import BLOCK, Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Manoeuvre, Tumble

LASTS = 20
"""Samples that the slow noise lasts for: a twelfth of a block of the recordings."""


def turned(scenario, seed, slow_T=0.0, count=4000):
    """Return a recording of a slow turn, with noise that lasts in each axis beside the white one."""
    scenario = replace(scenario, motion=Tumble(np.radians(20)), sample_count=count, rate_hz=10.0, seed=seed)
    recording = simulate(scenario).recording
    slow = lasting(np.random.default_rng([seed, 1]).normal(size=recording.readings_T.shape), LASTS)
    return replace(recording, readings_T=recording.readings_T + slow_T * slow)


def lasting(white, samples):
    """Return noise of the size of white noise, whose correlation falls to 1/e in some samples."""
    kept = np.exp(-1 / samples)
    return lfilter([np.sqrt(1 - kept**2)], [1, -kept], white, axis=0)


def fitted(recording, scenario):
    """Return the plain fit with the stated noise."""
    return maximum_likelihood(recording, scenario.array.with_stated_noise())


def pulls(calibration, errors):
    """Return the errors of all free parameters over their standard errors."""
    error = (calibration.errors.to_vector() - errors.to_vector()).ravel()
    free = calibration.standard_errors.ravel() > 0
    return error[free] / calibration.standard_errors.ravel()[free]


def test_white_noise_of_the_stated_size_widens_nothing(wu_scenario):
    """In none of 10 runs, where one of a thousand may be; the calibration is then the same to the last bit."""
    for seed in range(10):
        recording = turned(wu_scenario, seed)
        plain = fitted(recording, wu_scenario)
        assert widened(plain, recording).covariance.tolist() == plain.covariance.tolist()


def test_white_noise_of_a_noisy_scalar_widens_nothing(wu_scenario):
    """20 nT, as stated: it is no slow residual of the sensors' 1 nT."""
    recording = turned(wu_scenario, 3)
    noise_T = 20e-9 * np.random.default_rng(3).normal(size=recording.sample_count)
    recording = replace(recording, scalar_T=recording.scalar_T + noise_T)
    array = replace(wu_scenario.array.with_stated_noise(), scalar_noise_T=20e-9)
    assert variance_factors(maximum_likelihood(recording, array), recording) == WHITE


def test_few_samples_of_one_sensor_are_as_seldom_taken_for_slow(wu_scenario):
    """In none of 50 runs of 16 samples, where one in a thousand is expected: sums of few parameters are no χ²."""
    scenario = replace(wu_scenario, motion=Tumble(np.radians(60)), sample_count=16, rate_hz=1.0)
    array = Array(np.zeros((1, 3)), np.full(1, 1e-9), 1e-10)
    found = []
    for seed in range(50):
        recording = simulate(replace(scenario, seed=seed)).recording
        recording = replace(recording, readings_T=recording.readings_T[:, :1])
        found.append(variance_factors(maximum_likelihood(recording, array), recording))
    assert set(found) == {WHITE}


def test_noise_that_lasts_is_in_the_standard_errors(wu_scenario):
    """2 nT that last for 20 samples: 8 runs err by three of white noise's standard errors, and one of theirs."""
    white, slow = [], []
    for seed in range(8):
        recording = turned(wu_scenario, seed, 2e-9)
        plain = fitted(recording, wu_scenario)
        white.append(pulls(plain, wu_scenario.errors))
        slow.append(pulls(widened(plain, recording), wu_scenario.errors))
    assert np.sqrt(np.mean(np.square(white))) > 2.5
    assert 0.85 < np.sqrt(np.mean(np.square(slow))) < 1.15


@pytest.mark.parametrize("part_spoilt", [0, 0.03])
def test_a_robust_fit_holds_what_lasts_and_not_outliers(wu_scenario, part_spoilt):
    """2 nT that last for 20 samples: 6 runs err by four of its standard errors, and one of the widened ones.

    Spoilt samples, 100 nT off, do not pass for what lasts: alone they widen nothing.
    """
    narrow, wide = [], []
    for seed in range(6):
        recording = turned(wu_scenario, seed, 2e-9)
        plain = maximum_likelihood(spoilt(recording, part_spoilt), wu_scenario.array.with_stated_noise(), robust=True)
        narrow.append(pulls(plain, wu_scenario.errors))
        wide.append(pulls(widened(plain, spoilt(recording, part_spoilt)), wu_scenario.errors))
    assert np.sqrt(np.mean(np.square(narrow))) > 3.5
    assert 0.85 < np.sqrt(np.mean(np.square(wide))) < 1.15
    quiet = spoilt(turned(wu_scenario, 1), part_spoilt)
    plain = maximum_likelihood(quiet, wu_scenario.array.with_stated_noise(), robust=True)
    assert widened(plain, quiet).covariance.tolist() == plain.covariance.tolist()


@pytest.mark.parametrize("method", ["maximum_likelihood", "lossless"])
@pytest.mark.parametrize(("kept", "is_said"), [(0.8, False), (0.9999, True)])
def test_noise_that_outlasts_the_recording_is_said(wu_scenario, method, kept, is_said):
    """4000 samples show how much noise of five samples moves a bias, not how much that of ten thousand does."""
    white = np.random.default_rng(7).normal(size=(4000, 4, 3))
    recording = turned(wu_scenario, 7)
    noisy = recording.readings_T + 2e-9 * lfilter([1], [1, -kept], white, axis=0)
    calibration = calibrate(replace(recording, readings_T=noisy), wu_scenario.array.with_stated_noise(), method)
    assert (GROWING in calibration.warnings) == is_said
    assert calibration.variance_factors.differential > 5


def test_noise_that_a_robust_fit_finds_counts_once(wu_scenario):
    """Where it is not stated, standard errors are those of the found noise: it is in the weights, not beside them."""
    recording, array = (
        turned(wu_scenario, 2, 2e-9),
        replace(wu_scenario.array, vector_noise_T=None, scalar_noise_T=None),
    )
    found = maximum_likelihood(recording, array, robust=True)
    stated = maximum_likelihood(recording, found.array, robust=True)
    assert found.array.vector_noise_T[0] > 1.9e-9
    assert_allclose(found.standard_errors[1:], stated.standard_errors[1:], rtol=0.05)


def spoilt(recording, part):
    """Return a recording of which a part of the samples is off by 100 nT in every axis."""
    rng = np.random.default_rng(9)
    hit = rng.random(recording.sample_count) < part
    off = rng.normal(0, 100e-9, recording.readings_T.shape)
    return replace(recording, readings_T=recording.readings_T + hit[:, None, None] * off)


def test_robust_standard_errors_tell_the_variance_over_the_stated_noise(wu_scenario):
    """As those of maximum likelihood do: by how much a prior's readings are weighed does not depend on the method."""
    recording = turned(wu_scenario, 3, 2e-9)
    robust, plain = (calibrate(recording, wu_scenario.array, method) for method in ("robust", "maximum_likelihood"))
    for channel in ("slow_differential", "slow_common_mode"):
        assert_allclose(robust.reduced_chi_square[channel], plain.reduced_chi_square[channel], rtol=0.3)


@pytest.mark.parametrize(("channel", "parameters"), [("differential", 36), ("common_mode", 9)])
@pytest.mark.parametrize(("ratio", "sums", "is_told"), [(0.96, BLOCKS - 1, False), (1.04, COSINES, True)])
def test_more_than_chance_makes_once_in_a_thousand_is_told(wu_scenario, channel, parameters, ratio, sums, is_told):
    """Below that point of the χ² of all sums of each parameter, above that of the slow ones: the noise scales them."""
    recording, array = turned(wu_scenario, 1), wu_scenario.array.with_stated_noise()
    calibration = maximum_likelihood(recording, array)

    def factor_of(times):
        stated = replace(
            array, vector_noise_T=array.vector_noise_T / times, scalar_noise_T=array.scalar_noise_T / times
        )
        return getattr(variance_factors(replace(calibration, array=stated), recording), channel)

    point = chi2.isf(1e-3, sums * parameters) / (sums * parameters)
    assert (factor_of(3 * np.sqrt(ratio * point / factor_of(3.0))) > 1) == is_told


def test_noise_that_is_larger_than_stated_is_in_the_standard_errors(wu_scenario):
    """White noise, so many times the stated: variances are those of its square; 1.3 are 5 deviations from chance.

    Four runs tell that of the common mode, of a quarter of the parameters, as exactly.
    """
    found = {1.3: [], 3.0: []}
    for seed in range(1, 5):
        recording = turned(wu_scenario, seed)
        for times in (1.3, 3.0):
            noise = {"vector_noise_T": np.full(4, 1e-9 / times), "scalar_noise_T": 1e-10 / times}
            less = replace(wu_scenario.array.with_stated_noise(), **noise)
            found[times].append(variance_factors(maximum_likelihood(recording, less), recording))
    assert_allclose([found[times][0].differential for times in found], np.square(list(found)), rtol=0.25)
    assert_allclose(np.mean([factors.common_mode for factors in found[3.0]]), 9, rtol=0.25)


def test_blocks_of_the_file_do_not_matter(wu_scenario):
    """A recording of more than one block of samples gives what its own sums give, whatever the bounds."""
    recording = turned(wu_scenario, 2, 2e-9, BLOCK + 3000)
    calibration = fitted(recording, wu_scenario)
    numbers, parts = zip(*estimate._parts(recording), strict=True)
    assert sorted(set(numbers)) == list(range(16))
    assert len(parts) > 16
    assert_allclose(np.concatenate([part.time_s for part in parts]), recording.time_s, rtol=0)
    factors = variance_factors(calibration, recording)
    assert factors.differential > 5 and factors.common_mode > 5


def test_too_few_samples_tell_nothing(wu_scenario):
    """Of 15 samples, less than the blocks are, nothing is told; of 16 it is."""
    recording = turned(wu_scenario, 3, 30e-9)
    calibration = fitted(recording, wu_scenario)
    assert variance_factors(calibration, recording.take(slice(15))) == WHITE
    factors = variance_factors(calibration, recording.take(slice(16)))
    assert factors.differential > 1 and factors.common_mode > 1


@pytest.mark.parametrize("has_scalar", [True, False])
def test_a_calibration_says_by_how_much_they_are_wider(wu_scenario, has_scalar):
    """The larger factor, its root, stands in a warning; the covariance is the sandwich of the channels.

    Over all unknowns, the free intensity among them where there is no scalar, and with what is held.
    """
    recording = turned(wu_scenario, 4, 2e-9)
    recording = recording if has_scalar else replace(recording, scalar_T=None)
    calibration = calibrate(recording, wu_scenario.array.with_stated_noise())
    [warning] = [one for one in calibration.warnings if "the residual" in one]
    factor = max(calibration.variance_factors)
    few = f" but may still be too small ({calibration.samples / factor:.0f} independent samples)"
    slow = (
        f"; its slow part is {np.sqrt(factor):.3g} times that of white noise, and standard errors have been increased"
    )
    assert f"{slow}{few}: look" in warning
    expected = np.sqrt(np.diag(sandwich(calibration, recording))).reshape(4, 12)
    assert_allclose(calibration.standard_errors, expected, rtol=1e-3)


def sandwich(calibration, recording):
    """Return A⁻¹ (f_d I_d + f_c I_c) A⁻¹ of the errors, from the samples."""
    errors, array, unit_T = calibration.errors, calibration.array, calibration.intensity_T
    has_scalar = recording.scalar_T is not None
    data = Normalized(recording, errors.bias_T, unit_T, has_scalar)
    scalar_noise = array.scalar_noise_T / unit_T if has_scalar else 0.0
    likelihood = Likelihood(data, array.vector_noise_T / unit_T, scalar_noise)
    here = likelihood.linearize(errors.matrix, np.zeros((4, 3)))
    rows = rows_by_unknowns(errors, unit_T, None if has_scalar else unit_T)
    free = np.ones(rows.shape[1], dtype=bool)
    free[9:12] = False
    basis = free_basis(errors, free, holds_scale=not has_scalar)
    inside = basis.T @ rows.T @ here.both.information @ rows @ basis
    weighed = calibration.variance_factors
    spread = weighed.differential * (here.both.information - here.common.information)
    spread += weighed.common_mode * here.common.information
    bread = basis @ np.linalg.inv(inside) @ basis.T
    return (bread @ rows.T @ spread @ rows @ bread)[:48, :48]


def test_an_update_weighs_slow_residuals_as_what_they_tell(wu_scenario):
    """A turn with 5 nT that last contradicts no prior; taken for white it does, and moves sensors that are at rest."""
    array = wu_scenario.array.with_stated_noise()
    prior = calibrate(turned(wu_scenario, 5), array)
    moved = [calibrate(turned(wu_scenario, seed, 5e-9, 1000), array, prior=prior) for seed in (6, 7)]
    assert [calibration.update.moved for calibration in moved] == [()] * 2
    assert np.sqrt(np.mean(np.square([pulls(one, wu_scenario.errors) for one in moved]))) < 1.3


def test_a_field_that_lasts_is_no_change_of_the_sensors(wu_scenario):
    """Without a scalar its intensity, off by 40 nT for ten samples, is no change of a sensor near the recording's end.

    The samples before that are looked at too: they last as those after it.
    """
    array, found = replace(wu_scenario.array.with_stated_noise(), change_rates=UNCHANGING), []
    prior = calibrate(turned(wu_scenario, 40), array)
    limit, bias_T = np.radians(20), wu_scenario.errors.bias_T
    for seed in (40, 41):
        turn = replace(wu_scenario, motion=Manoeuvre(limit, limit, 60.0), sample_count=2000, rate_hz=5.0, seed=seed)
        recording = simulate(turn).recording
        off = 40e-9 * lasting(np.random.default_rng(seed).normal(size=(2000, 1, 1)), 10) / prior.intensity_T
        readings_T = bias_T + (recording.readings_T - bias_T) * (1 + off)
        found.append(calibrate(replace(recording, readings_T=readings_T, scalar_T=None), array, prior=prior))
    assert [calibration.update.moved for calibration in found] == [()] * 2
    assert np.sqrt(np.mean(np.square([pulls(one, wu_scenario.errors) for one in found]))) < 1.3


def test_an_update_expects_what_was_slow_before(wu_scenario):
    """A prior whose residuals lasted gives its factor to an update of too few samples to show one."""
    array = wu_scenario.array.with_stated_noise()
    prior = calibrate(turned(wu_scenario, 12, 2e-9), array)
    update = calibrate(turned(wu_scenario, 13, 0.0, 15), array, prior=prior, accept=["few_samples"])
    assert update.variance_factors == prior.variance_factors != WHITE


def test_a_scalar_that_is_silent_for_a_while_makes_nothing_slow(wu_scenario):
    """A fifth of the recording without intensities: white noise stays white, and what moved is found with its size."""
    array = wu_scenario.array.with_stated_noise()
    recording = turned(wu_scenario, 14, count=2000)
    scalar_T, readings_T = recording.scalar_T.copy(), recording.readings_T.copy()
    scalar_T[600:1000] = np.nan
    silent = replace(recording, scalar_T=scalar_T)
    assert calibrate(silent, array).variance_factors == WHITE
    readings_T[:, 2] += [20e-9, 0, 0]
    update = calibrate(replace(silent, readings_T=readings_T), array, prior=calibrate(turned(wu_scenario, 15), array))
    [moved] = update.update.moved
    assert (moved.kind, moved.sensor) == ("bias", 3) and update.variance_factors == WHITE
    assert_allclose(moved.change, [20e-9, 0, 0], atol=2e-9)


def test_what_is_fitted_beside_the_errors_is_widened_by_no_more_than_the_larger_factor():
    """Nor by less than the smaller one, where an ambient gradient left the covariance more than the channels tell."""
    generator = np.random.default_rng(16)
    differential = np.cov(generator.normal(size=(12, 40)))
    differential[9:] = differential[:, 9:] = 0
    common = np.zeros((12, 12))
    common[9:, 9:] = np.cov(generator.normal(size=(3, 40)))
    root = generator.normal(size=(12, 2))
    covariance = np.linalg.inv(differential + common) + root @ root.T
    for factors in (VarianceFactors(4.0, 900.0), VarianceFactors(900.0, 4.0)):
        wider = estimate._sandwich(covariance, differential, factors)
        ratio = eigh(wider, covariance, eigvals_only=True)
        assert 3.999 < ratio.min() < 4.001 and 100 < ratio.max() < 900.1


SLOW_T, SLOW_LASTS = 40e-9, 10
"""What a vehicle adds to the scalar, and for how many samples it lasts."""

TOLERANCES = Tolerances(0.005, np.radians(0.5), 50e-9, np.radians(1))
"""Of the sensors of a vehicle."""

CROSS = replace(Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10), change_rates=UNCHANGING)
"""Of sensors that stay as they are."""


def drawn(seed):
    """Return errors of four sensors as the tolerances have them."""
    vector = np.random.default_rng([seed, 0]).normal(size=(4, 12)) * np.sqrt(TOLERANCES.variances())
    vector[:, :3] += 1
    return in_first_frame(SensorErrors.from_vector(vector, SensorErrors.none(4).orientation))[0]


def on_vehicle(errors, seed, tilt, slow_T=SLOW_T, count=1000, start_s=0.0):
    """Return a recording of circles with so much pitch and roll, degrees: white sensors, and a slow scalar."""
    generator = np.random.default_rng([seed, 1])
    time_s = start_s + 0.2 * np.arange(count)
    attitude = Manoeuvre(np.radians(tilt), np.radians(tilt), 60.0).attitudes(time_s, generator)
    field_T = Rotation.from_quat(attitude).inv().apply([3e-6, 18e-6, -46e-6])
    readings_T = errors.distort(field_T) + 1e-9 * generator.normal(size=(count, 4, 3))
    slow = lasting(generator.normal(size=count + 100), SLOW_LASTS)[100:]
    scalar_T = np.linalg.norm(field_T, axis=1) + 1e-10 * generator.normal(size=count)
    return Recording(time_s, readings_T, scalar_T + slow_T * slow)


def principal_pulls(calibration, errors):
    """Return the errors along the principal directions of their correlation over the standard deviations there."""
    free = calibration.standard_errors.ravel() > 0
    deviation = calibration.standard_errors.ravel()[free]
    variance, directions = np.linalg.eigh(calibration.covariance[np.ix_(free, free)] / np.outer(deviation, deviation))
    return directions.T @ pulls(calibration, errors) / np.sqrt(variance)


def alone(errors, seed):
    """Return a calibration by all attitudes."""
    return calibrate(on_vehicle(errors, seed, 60), CROSS)


def of_prior(errors, seed):
    """Return the update by ±20° of a calibration whose scalar was quiet."""
    prior = calibrate(on_vehicle(errors, seed + 100, 60, 0.0), CROSS)
    return calibrate(on_vehicle(errors, seed, 20, start_s=1e4), CROSS, prior=prior)


def of_slow_prior(errors, seed):
    """Return the update by ±20° of a calibration whose scalar was as slow."""
    prior = calibrate(on_vehicle(errors, seed + 100, 60), CROSS)
    return calibrate(on_vehicle(errors, seed, 20, start_s=1e4), CROSS, prior=prior)


def beside_tolerances(errors, seed):
    """Return a calibration by ±10° beside the tolerances."""
    return calibrate(on_vehicle(errors, seed, 10, count=600), replace(CROSS, tolerances=TOLERANCES))


@pytest.mark.parametrize(("make", "runs"), [(alone, 3), (of_prior, 3), (of_slow_prior, 3), (beside_tolerances, 4)])
def test_a_slow_scalar_is_noise_of_the_intensity_alone(make, runs):
    """40 nT that last for ten samples, between sensors of 1 nT: errors of some runs are one standard error.

    So are those of their principal directions, of which the relative ones are known 300 times as well. The variance of
    the common mode is that of noise of this size and duration; the differences count as white.
    """
    found, principal, common = [], [], []
    for seed in range(runs):
        errors = drawn(seed)
        calibration = make(errors, seed)
        assert calibration.variance_factors.differential == 1
        common.append(calibration.variance_factors.common_mode)
        found.append(pulls(calibration, errors))
        principal.append(principal_pulls(calibration, errors))
    kept = np.exp(-1 / SLOW_LASTS)
    white_T2 = 1e-10**2 + 1e-9**2 / 4
    expected = SLOW_T**2 / white_T2 * (1 + kept) / (1 - kept)
    assert 0.5 * expected < np.median(common) < 1.5 * expected
    assert 0.8 < np.sqrt(np.mean(np.square(found))) < 1.3
    assert 0.8 < np.sqrt(np.mean(np.square(principal))) < 1.3
