"""The intensity between slow scalar readings: its line, its uncertainty, and what neighbouring samples share."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.reference import interpolate, is_worth_interpolating
from tam_calibration.model.recording import Recording
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import ScalarReference, SinusoidDrift, Tumble


def interpolated(time, scalar, noise):
    """Return the intensity at all samples, and its standard deviation."""
    intensity, errors = interpolate(time, scalar, noise)
    deviation = np.full(len(time), np.nan)
    deviation[np.isfinite(intensity)] = np.sqrt(errors.variance)
    return intensity, deviation


def slow(values, step):
    """Return a copy of values of which every step-th is left."""
    sparse = np.full(len(values), np.nan)
    sparse[::step] = values[::step]
    return sparse


def test_a_steady_drift_is_followed_exactly():
    """Between readings that lie on a line the intensity does, and nothing wanders."""
    time = np.arange(101) / 10
    true = 50.0 + 0.3 * time
    intensity, deviation = interpolated(time, slow(true, 20), 0.0)
    assert_allclose(intensity, true, rtol=1e-14)
    assert_allclose(deviation, 0, atol=1e-6)


def test_no_sample_is_extrapolated_and_no_long_gap_bridged():
    """Before the first reading, after the last and across missing ones there is no intensity."""
    time = np.arange(100.0)
    scalar = slow(np.full(100, 50.0), 5)
    scalar[:3] = np.nan
    scalar[30:60] = np.nan
    intensity, deviation = interpolated(time, scalar, 0.1)
    assert np.isnan(intensity[:5]).all() and np.isnan(intensity[96:]).all()
    assert np.isnan(intensity[26:60]).all()
    assert_array_equal(intensity[np.r_[5:26, 60:96]], 50.0)
    assert_array_equal(np.isnan(deviation), np.isnan(intensity))


def test_the_middle_of_two_readings_has_half_their_variance():
    """A field that stands still gives readings of the noise that is stated, and means of them in between."""
    time = np.arange(40_001.0)
    noise = np.random.default_rng(1).normal(0, 0.1, len(time))
    _, deviation = interpolated(time, slow(50 + noise, 4), 0.1)
    assert_allclose(deviation[::4], 0.1, rtol=1e-12)
    assert_allclose(deviation[2::4], 0.1 / np.sqrt(2), rtol=0.02)


@pytest.mark.parametrize("rate", [0.01, 1.0])
def test_a_random_walk_is_told_as_it_is(rate):
    """The interpolated intensity errs by what it tells, for a field that wanders without aim."""
    generator = np.random.default_rng(2)
    time = np.arange(30_001) / 10
    true = 50 + np.cumsum(generator.normal(0, np.sqrt(rate / 10), len(time)))
    intensity, deviation = interpolated(time, slow(true + generator.normal(0, 0.1, len(time)), 50), 0.1)
    ratio = (intensity - true) / deviation
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1, abs=0.15)


def test_a_smooth_drift_is_not_taken_for_a_walk():
    """A sinusoid of 24 readings a period is told to within a factor of two, not of four as a walk would be."""
    time = np.arange(12_001) / 10
    true = 50 + 10 * np.sin(2 * np.pi * time / 120)
    intensity, deviation = interpolated(time, slow(true, 50), 0.0)
    error = np.sqrt(np.mean((intensity - true) ** 2))
    assert error < np.sqrt(np.mean(deviation**2)) < 2 * error


@pytest.mark.parametrize("noise", [0.0, 0.3])
@pytest.mark.parametrize("rate", [0.0, 0.05, None])
def test_shared_errors_have_the_covariance_of_the_model(noise, rate):
    """Against the covariance written out: uneven times, a gap, readings side by side."""
    generator = np.random.default_rng(3)
    time = np.cumsum(generator.uniform(0.5, 1.5, 60))
    scalar = np.full(60, np.nan)
    readings = [3, 9, 10, 17, 25, 26, 33, 55]
    scalar[readings] = generator.normal(50, 1, 8)
    _, errors = interpolate(time, scalar, noise)
    errors = errors if rate is None else replace(errors, rate=rate)
    count = len(errors.way)
    line = np.zeros((count, len(readings)))
    line[np.arange(count), errors.interval] += 1 - errors.way
    line[np.arange(count), errors.interval + 1] += errors.way
    first, last = np.minimum.outer(errors.way, errors.way), np.maximum.outer(errors.way, errors.way)
    walk = np.equal.outer(errors.interval, errors.interval) * errors.gap_s * first * (1 - last)
    shared = noise**2 * line @ line.T + errors.rate * walk
    assert_allclose(np.diag(shared), errors.variance, atol=1e-14)
    own, columns = generator.uniform(0.1, 0.5, count), generator.normal(size=(count, 4))
    alone = columns.T @ (columns / own[:, None])
    expected = alone - columns.T @ np.linalg.solve(np.diag(own) + shared, columns)
    assert_allclose(errors.explained(columns / own[:, None], 1 / own), expected, atol=1e-11)


def test_only_a_slow_scalar_is_interpolated():
    """Readings in most samples, in too few, or in none leave nothing to gain."""
    every_second, most = np.full(100, np.nan), np.full(100, 50.0)
    every_second[::2] = 50.0
    most[::3] = np.nan

    def is_worth_it(scalar):
        return is_worth_interpolating(Recording(np.arange(100.0), np.zeros((100, 1, 3)), scalar))

    assert is_worth_it(every_second)
    assert not is_worth_it(most)
    assert not is_worth_it(np.full(100, 50.0))
    assert not is_worth_it(slow(np.full(100, 50.0), 60))
    assert not is_worth_it(None)


@pytest.fixture(scope="module")
def tumbling(wu_scenario):
    """Return ten minutes of a tumble at 10 Hz with a proton magnetometer that reads every 5 s."""
    return replace(
        wu_scenario, motion=Tumble(np.pi / 30), sample_count=6000, rate_hz=10, scalar=ScalarReference(rate_hz=0.2)
    )


@dataclass(frozen=True)
class WalkDrift:
    """An intensity that wanders without aim."""

    rate_T2_per_s: float
    seed: int

    def variation_T(self, time_s, site_field_T):
        """Return what is added to the site field."""
        step = np.sqrt(self.rate_T2_per_s * (time_s[1] - time_s[0]))
        walk = np.cumsum(np.random.default_rng(self.seed).normal(0, step, len(time_s)))
        return np.outer(walk, site_field_T / np.linalg.norm(site_field_T))


@pytest.mark.parametrize("drift", ["none", "sinusoid", "walk"])
def test_errors_lie_within_their_standard_errors(tumbling, drift):
    """One reading for 50 samples does not count 50 times: the squared errors have the mean of a chi-square."""
    free = np.r_[:9, 12:48]
    scores = []
    for seed in range(10):
        field = {"none": None, "sinusoid": SinusoidDrift(8.26e-9, 120.0), "walk": WalkDrift((0.3e-9) ** 2, seed)}
        run = simulate(replace(tumbling, seed=seed, drift=field[drift]))
        calibration = maximum_likelihood(run.recording, tumbling.array)
        error = (calibration.errors.to_vector() - run.errors.to_vector()).ravel()[free]
        scores.append(error @ np.linalg.solve(calibration.covariance[np.ix_(free, free)], error))
    assert abs(np.mean(scores) - 45) < 7.5


def test_interpolation_helps(tumbling, monkeypatch):
    """Against counting samples without a reading only among the sensors, standard errors fall threefold."""
    recording = simulate(tumbling).recording
    interpolated = maximum_likelihood(recording, tumbling.array).standard_errors
    monkeypatch.setattr("tam_calibration.fit.likelihood.is_worth_interpolating", lambda source: False)
    dropped = maximum_likelihood(recording, tumbling.array).standard_errors
    assert np.median(dropped[:, :9] / interpolated[:, :9]) > 3
    assert_allclose(dropped[1:, 9:] / interpolated[1:, 9:], 1, atol=0.05)
