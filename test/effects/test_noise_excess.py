"""Noise that exceeds that of the other rows: whose it is and how large, and what is no noise."""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view
from numpy.testing import assert_allclose

from tam_calibration.effects.excess_variance import ChannelMoments, best_excess
from tam_calibration.effects.noise_excess import NoiseExcess
from tam_calibration.effects.regularity import objection_to
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution

EXCESS = NoiseExcess()


def to_and_fro(time_s):
    """Return one of two states at each time, at random."""
    return np.random.default_rng(4).choice([-1.0, 1.0], len(time_s))


def noise(sensor, axis=None, size=1e-9):
    """Return what the effect does at one place."""
    return Contribution(sensor, axis, "noise", {"standard deviation": size})


@pytest.mark.parametrize("sheet", [0.8, 0.88, 1.0, 1.12])
@pytest.mark.parametrize(("samples", "sensors"), [(60, 4), (2000, 4), (500, 12), (2000, 2), (2000, 1)])
def test_a_wrong_data_sheet_is_no_excess(bench, samples, sensors, sheet):
    """Noise that all sensors have alike, or that the scalar has more by less than 30 %, is the floor."""
    for seed in range(5):
        made = bench(samples, sensors, seed=seed, sheet=sheet)
        assert isinstance(EXCESS.find(made.residuals()), str)


def test_noise_of_all_sensors_beyond_a_wrong_data_sheet(bench):
    """One and a half times the noise stated is told of all sensors, with its size within its error."""
    made = bench(2000, 4, seed=1, sheet=1.5)
    (part,) = EXCESS.find(made.residuals()).fitted.contributions
    assert (part.sensor, part.axis) == (ALL, None)
    stated = np.sqrt(np.mean(made.residuals().covariates.array.vector_noise_T ** 2))
    value, error = part.values["standard deviation"], part.standard_errors["standard deviation"]
    assert abs(value - stated * np.sqrt(1.5**2 - 1)) < 3.5 * error


@pytest.mark.parametrize(("sensor", "axis"), [(1, 2), (3, None), (SCALAR, None)])
@pytest.mark.parametrize("moves", [True, False])
def test_the_noisy_row_is_found(bench, sensor, axis, moves):
    """Place and size come out within their standard errors, on a floor that is not the data sheet's."""
    size = 0.6e-9 if sensor == SCALAR else 1e-9
    made = bench(moves=moves, sheet=1.1).with_effect(EXCESS, noise(sensor, axis, size))
    residuals = made.residuals()
    found = EXCESS.find(residuals)
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis) == (sensor, axis)
    value, error = part.values["standard deviation"], part.standard_errors["standard deviation"]
    assert abs(value - size) < 3.5 * error and 0 < error < 0.1 * size
    assert found.gain - found.parameter_count * np.log(residuals.channel_count.sum()) > 50
    rows = {SCALAR: [12], 1: [5], 3: [9, 10, 11]}[sensor]
    assert_allclose(found.variance[rows], value**2, rtol=1e-6)
    assert not np.delete(found.variance, rows).any()


def test_the_gain_is_that_of_the_likelihood(bench):
    """Twice the log likelihood ratio against one free variance, as full covariance matrices give it."""
    made = bench(300, has_scalar=False).with_effect(EXCESS, noise(1, 2, 1.5e-9))
    residuals = made.residuals()
    found = EXCESS.find(residuals)
    own = found.variance[5]

    def deviance(floor, variance):
        total = 0.0
        for sample in range(300):
            shift = np.append(residuals.directions[5], residuals.row_slope[sample, 5])
            covariance = floor * np.eye(10) + variance * np.outer(shift, shift)
            residual = np.append(residuals.differential[sample], residuals.common_mode[sample])
            total += np.linalg.slogdet(covariance)[1] + residual @ np.linalg.solve(covariance, residual)
        return total

    from scipy.optimize import minimize_scalar

    without = minimize_scalar(lambda floor: deviance(floor, 0.0), bounds=(0.5, 3.0), method="bounded").fun
    beside = minimize_scalar(lambda floor: deviance(floor, own), bounds=(0.5, 3.0), method="bounded").fun
    assert_allclose(found.gain, without - beside, rtol=0.01)


@pytest.mark.parametrize("slope", [0.3, 0.7])
def test_coloured_noise_counts(bench, slope):
    """1/f noise of one axis is an excess, too; so is noise that comes and goes."""
    made = bench()
    spectrum = np.fft.rfft(np.random.default_rng(3).normal(0, 2e-9, 2000))
    spectrum[1:] *= (np.arange(1, len(spectrum)) / len(spectrum)) ** (-slope / 2)
    rows = made.rows_T.copy()
    rows[:, 4] += np.fft.irfft(spectrum, 2000)
    (part,) = EXCESS.find(made.with_rows(rows).residuals()).fitted.contributions
    assert (part.sensor, part.axis) == (1, 1)


@pytest.mark.parametrize("samples", [72, 400])
def test_white_noise_of_few_samples_follows_nothing(bench, samples):
    """Of a hundred recordings with a noisy scalar none has noise whose size goes with the direction or its rate."""
    made = bench(samples)
    for seed in range(100):
        rows = made.rows_T.copy()
        rows[:, -1] += np.random.default_rng(seed).normal(0, 20e-9, samples)
        found = EXCESS.find(made.with_rows(rows).residuals())
        assert not isinstance(found, str) or "the size of the excess" not in found


def test_noise_for_a_while_counts(bench):
    """An axis that is loud in a third of the record has excess noise."""
    made = bench()
    rows = made.rows_T.copy()
    rows[500:1200, 4] += np.random.default_rng(3).normal(0, 3e-9, 700)
    (part,) = EXCESS.find(made.with_rows(rows).residuals()).fitted.contributions
    assert (part.sensor, part.axis) == (1, 1)


@pytest.mark.parametrize(
    ("course", "sentence"),
    [
        (lambda time, direction: np.where(time > 90, 6e-9, -6e-9), "a course in time"),
        (lambda time, direction: 6e-9 * np.sin(2 * np.pi * time / 61), "a course in time"),
        (lambda time, direction: 4e-9 * np.sin(2 * np.pi * 3.217 * time), "a line of the spectrum"),
        (lambda time, direction: 9e-9 * np.sin(5 * direction), "follows the direction of the field"),
        (lambda time, direction: 9e-9 * direction * to_and_fro(time), "the size of the excess follows the direction"),
        (
            lambda time, direction: 9e-9 * (direction + 0.7) * np.sign(np.sin(0.9 * time)),
            "the size of the excess follows the direction",
        ),
        (lambda time, direction: 4e-7 * np.gradient(direction) * to_and_fro(time), "follows the rate of the field"),
        (lambda time, direction: 6e-9 * to_and_fro(time), "goes between few values"),
        (lambda time, direction: 6e-9 * (np.random.default_rng(4).exponential(size=len(time)) - 1), "goes to one side"),
    ],
)
def test_what_has_a_regular_cause_is_no_noise(bench, course, sentence):
    """A jump, a slow drift, a line, a function of the direction, gains and offsets of two states, pulses: no noise."""
    made = bench(moves=False)
    rows, covariates = made.rows_T.copy(), made.covariates
    rows[:, 4] += course(covariates.time_s, covariates.field_T[:, 1] / covariates.intensity_T)
    assert sentence in EXCESS.find(made.with_rows(rows).residuals())


@pytest.mark.parametrize(("up", "is_noise"), [(0.65, True), (0.85, False)])
def test_noise_goes_to_both_sides(bench, up, is_noise):
    """Of 250 pulses 65 % of one sign are two and a half standard deviations from half of them, 85 % are seven."""
    made, generator = bench(), np.random.default_rng(4)
    rows = made.rows_T.copy()
    signs = np.where(generator.random(250) < up, 1, -1)
    rows[np.sort(generator.choice(2000, 250, replace=False)), 4] += generator.normal(3e-9, 0.5e-9, 250) * signs
    found = EXCESS.find(made.with_rows(rows).residuals())
    assert (found == "the excess goes to one side") != is_noise


def test_spikes_are_no_noise(bench):
    """Few large readings are left to outliers, and do not count once they are."""
    made = bench()
    rows = made.rows_T.copy()
    rows[::100, 4] += 30e-9
    residuals = made.with_rows(rows).residuals()
    assert "spikes" in EXCESS.find(residuals)
    rest = np.arange(2000) % 100 > 0
    assert isinstance(EXCESS.find(made.with_rows(rows).residuals(is_counted=rest)), str)


def test_too_few_samples_are_told(bench):
    """Twenty samples tell no variance."""
    assert "24 samples" in EXCESS.find(bench(20).residuals())


def test_added_noise_has_the_stated_size(bench):
    """In simulations every axis of the sensor has noise of its own."""
    made = bench(20_000)
    change = made.with_effect(EXCESS, noise(2, None, 3e-9)).rows_T - made.rows_T
    assert_allclose(change[:, 6:9].std(axis=0), 3e-9, rtol=0.02)
    assert np.abs(np.corrcoef(change[:, 6:9].T) - np.eye(3)).max() < 0.03
    assert not change[:, [0, 1, 2, 3, 4, 5, 9, 10, 11, 12]].any()


def excess(made, row, variance_T2):
    """Return the excess that is told of so much in one row."""
    rows = made.rows_T.copy()
    rows[:, row] += np.random.default_rng(3).normal(0, np.sqrt(variance_T2), len(rows))
    residuals = made.with_rows(rows).residuals()
    return best_excess(ChannelMoments.of(residuals), residuals.covariates)


@pytest.mark.parametrize(("part", "is_told"), [(0.08, False), (0.13, True)])
def test_axes_of_a_kind_differ_by_a_tenth(bench, part, is_told):
    """An axis with eight per cent more variance than stated is none that is noisier, one with thirteen is."""
    assert (excess(bench(20_000), 4, part * 1e-18) is not None) == is_told


@pytest.mark.parametrize(("part", "is_told"), [(0.8, False), (1.4, True)])
def test_a_scalar_may_have_nearly_half_more(bench, part, is_told):
    """Its data sheet may err by a fifth, and that of the sensors by as much the other way."""
    assert (excess(bench(4000, noise_T=1e-10), 12, part * 1e-20) is not None) == is_told


@pytest.mark.parametrize(("part", "is_noise"), [(0.14, True), (0.28, False)])
def test_noise_of_all_sensors_is_hardly_shared_by_neighbouring_samples(bench, part, is_noise):
    """Means of eight samples have three quarters of their variance in common with the next three samples."""
    made, generator = bench(4000), np.random.default_rng(3)
    slow = sliding_window_view(generator.normal(size=(4007, 12)), 8, axis=0).sum(axis=2) / np.sqrt(8)
    rows = made.rows_T.copy()
    rows[:, :12] += 1.5e-9 * np.sqrt(part / 0.75) * slow
    rows[:, :12] += 1.5e-9 * np.sqrt(1 - part / 0.75) * generator.normal(size=slow.shape)
    found = EXCESS.find(made.with_rows(rows).residuals())
    assert (found == "the excess follows a course in time") == (not is_noise)
    assert isinstance(found, str) or found.fitted.contributions[0].sensor == ALL


def mixed(part, course, seed=7):
    """Return white noise of which so much of the variance is a course."""
    return np.sqrt(part) * course / np.std(course) + np.sqrt(1 - part) * np.random.default_rng(seed).normal(size=2000)


def between(low_hz, high_hz):
    """Return noise in a part of a spectrum that ends at 5 Hz."""
    spectrum = np.fft.rfft(np.random.default_rng(8).normal(size=2000))
    frequency = np.fft.rfftfreq(2000, 0.1)
    return np.fft.irfft(spectrum * ((frequency > low_hz) & (frequency <= high_hz)), 2000)


def sized(size):
    """Return noise without tails of so much in each sample."""
    generator = np.random.default_rng(7)
    return generator.choice([-1.0, 1.0], 2000) * np.sqrt(generator.uniform(0.2, 1, 2000)) * size


def struck(times):
    """Return noise of which one sample in seven is so many times as large."""
    generator = np.random.default_rng(7)
    return generator.normal(size=2000) * np.where(generator.random(2000) < 0.15, times, 1.0)


@pytest.mark.parametrize(
    ("signal", "sentence", "is_so"),
    [
        (lambda time, y: mixed(0.4, np.sin(2 * np.pi * 3.217 * time)), "a line of the spectrum", False),
        (lambda time, y: mixed(0.65, np.sin(2 * np.pi * 3.217 * time)), "a line of the spectrum", True),
        (lambda time, y: mixed(0.65, between(1.25, 1.5)), "a line of the spectrum", False),
        (lambda time, y: mixed(0.65, between(1.25, 1.375)), "a line of the spectrum", True),
        (lambda time, y: mixed(0.18, np.sin(5 * y)), "the excess follows the direction", False),
        (lambda time, y: mixed(0.35, np.sin(5 * y)), "the excess follows the direction", True),
        (lambda time, y: sized(1 + 0.07 * y**2), "size of the excess follows the direction", False),
        (lambda time, y: sized(1 + 0.1 * y**2), "size of the excess follows the direction", True),
        (lambda time, y: struck(2.7), "comes as spikes", False),
        (lambda time, y: struck(3.3), "comes as spikes", True),
        (lambda time, y: mixed(0.36, to_and_fro(time)), "goes between few values", False),
        (lambda time, y: mixed(0.55, to_and_fro(time)), "goes between few values", True),
    ],
)
def test_from_some_part_on_what_is_regular_is_no_noise(bench, signal, sentence, is_so):
    """Beside white noise: half in a fortieth of the band, a quarter by the direction, and so on."""
    made = bench(moves=False)
    covariates = made.covariates
    assert (sentence in objection_for(made, signal(covariates.time_s, covariates.field_T[:, 1] / 50e-6))) == is_so


@pytest.mark.parametrize(("growth", "is_so"), [(0.11, False), (0.16, True)])
def test_a_size_that_grows_with_the_rate_is_no_noise(bench, growth, is_so):
    """Where the rate tells a hundredth of the variance of the squares beyond chance; half of that may be noise."""
    made = bench(moves=False)
    rate = np.linalg.norm(np.gradient(made.covariates.field_T / 50e-6, axis=0), axis=1)
    assert ("follows the rate" in objection_for(made, sized(1 + growth * rate))) == is_so


def objection_for(made, signal):
    """Return what speaks against noise as the cause of a signal ten times as large as the noise in one row."""
    rows = made.rows_T.copy()
    rows[:, 4] += 10e-9 * signal
    residuals = made.with_rows(rows).residuals()
    return objection_to(residuals, best_excess(ChannelMoments.of(residuals), residuals.covariates)) or ""


def test_forty_samples_tell_a_variance(bench):
    """They are not too few."""
    assert "samples or more" not in EXCESS.find(bench(42).residuals())
