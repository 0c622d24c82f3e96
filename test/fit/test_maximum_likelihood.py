from dataclasses import replace

import numpy as np
import pytest
from live_mission import dive, recording_of
from numpy.testing import assert_allclose

from tam_calibration.fit.information import bound
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation import simulate


def test_covariance_is_the_bound_at_the_estimate(wu_run, wu_scenario):
    """The covariance of the estimate is the Cramér-Rao bound at the truth, to what the estimate's error moves it."""
    calibration = maximum_likelihood(wu_run.recording, wu_scenario.array)
    smallest = np.sqrt(np.diag(bound(wu_run.center_field_T, wu_run.errors, wu_scenario.array, has_scalar=True)))
    assert_allclose(calibration.standard_errors.ravel(), smallest, rtol=1e-3, atol=1e-20)


def test_errors_lie_within_their_standard_errors(wu_runs, wu_scenario):
    """Over 20 runs the squared errors in units of their covariance have the mean of a chi-square."""
    free = np.r_[:9, 12:48]
    scores = []
    for run in wu_runs:
        calibration = maximum_likelihood(run.recording, wu_scenario.array)
        error = (calibration.errors.to_vector() - run.errors.to_vector()).ravel()[free]
        scores.append(error @ np.linalg.solve(calibration.covariance[np.ix_(free, free)], error))
    # Of 20 draws with 45 degrees of freedom the mean has the standard deviation √(2 · 45 / 20).
    assert abs(np.mean(scores) - 45) < 6


def test_a_constant_reference_is_a_legal_reference(noise_free, wu_scenario):
    """A scalar channel that never changes fixes the scale as a varying one does."""
    constant = replace(noise_free.recording, scalar_T=np.full(noise_free.recording.sample_count, 54955.83e-9))
    calibration = maximum_likelihood(constant, wu_scenario.array)
    assert calibration.has_scalar_reference
    assert_allclose(calibration.errors.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-16)


def test_without_reference_all_but_the_scale_is_found(noise_free, wu_scenario):
    """Without a scalar the determinants have the geometric mean 1, and ratios of scale factors are exact."""
    alone = replace(noise_free.recording, scalar_T=None)
    calibration = maximum_likelihood(alone, wu_scenario.array)
    assert not calibration.has_scalar_reference
    assert np.linalg.det(calibration.errors.matrix).prod() == pytest.approx(1.0, abs=1e-12)
    ratio = calibration.errors.scale_factor / noise_free.errors.scale_factor
    assert_allclose(ratio, ratio[0, 0], rtol=1e-12)
    assert_allclose(calibration.errors.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-16)
    assert calibration.intensity_T * ratio[0, 0] == pytest.approx(54955.83e-9, rel=1e-9)
    assert any("absolute scale is unknown" in statement for statement in calibration.statements)


def test_standard_errors_hold_without_a_reference(wu_runs, wu_scenario):
    """Without a scalar the spread of 20 estimates agrees with the standard errors that are told."""
    scale = np.linalg.det(wu_scenario.errors.matrix).prod() ** (1 / 12)
    truth = SensorErrors.from_matrix(wu_scenario.errors.matrix / scale, wu_scenario.errors.bias_T).to_vector()
    found = [maximum_likelihood(replace(run.recording, scalar_T=None), wu_scenario.array) for run in wu_runs]
    spread = np.mean([(each.errors.to_vector() - truth) ** 2 for each in found], axis=0)
    told = np.mean([each.standard_errors for each in found], axis=0) ** 2
    ratio = spread[told > 0] / told[told > 0]
    assert ratio.mean() == pytest.approx(1.0, abs=0.28)
    assert ratio.max() < 2.5


def test_samples_without_a_scalar_reading_still_count(wu_run, wu_scenario):
    """With nine of ten scalar readings missing, misalignment is as good, and the scale is worse but found."""
    sparse = np.where(np.arange(wu_run.recording.sample_count) % 10 == 0, wu_run.recording.scalar_T, np.nan)
    full = maximum_likelihood(wu_run.recording, wu_scenario.array)
    calibration = maximum_likelihood(replace(wu_run.recording, scalar_T=sparse), wu_scenario.array)
    assert_allclose(calibration.standard_errors[1:, 9:], full.standard_errors[1:, 9:], rtol=0.2)
    z = (calibration.errors.to_vector() - wu_run.errors.to_vector())[:, :3] / calibration.standard_errors[:, :3]
    assert np.abs(z).max() < 5


def test_a_bias_many_times_the_field_is_found(noise_free, wu_scenario):
    """A hard iron of ten times the field does not spoil the fit."""
    offset = np.array([[400e-6, -300e-6, 500e-6], [0, 0, 0], [0, 100e-6, 0], [-600e-6, 0, 0]])
    moved = replace(noise_free.recording, readings_T=noise_free.recording.readings_T + offset)
    found = maximum_likelihood(moved, wu_scenario.array).errors
    assert_allclose(found.bias_T, noise_free.errors.bias_T + offset, rtol=0, atol=1e-15)


def test_unequal_noise_is_weighted(wu_scenario):
    """With one sensor five times noisier its neighbours' misalignment stays as good as the bound says."""
    array = replace(wu_scenario.array, vector_noise_T=np.array([1e-9, 5e-9, 1e-9, 1e-9]))
    runs = [simulate(replace(wu_scenario, array=array, seed=seed)).recording for seed in range(15)]
    found = [maximum_likelihood(recording, array) for recording in runs]
    errors = [each.errors.misalignment - wu_scenario.errors.misalignment for each in found]
    told = np.mean([each.standard_errors[2:, 9:] ** 2 for each in found], axis=0)
    assert (np.mean(np.square(errors), axis=0)[2:] / told).mean() == pytest.approx(1.0, abs=0.42)


def test_nine_poses_on_a_circle_determine_no_ellipsoid(wu_scenario):
    """Readings in one plane are refused, not fitted."""
    angle = np.arange(9) * 2 * np.pi / 9
    field = 5e-5 * np.stack([0.5 * np.cos(angle), 0.5 * np.sin(angle), np.full(9, -0.8)], axis=1)
    recording = Recording(np.arange(9.0), SensorErrors.none(4).distort(field), np.full(9, 4.7e-5))
    with pytest.raises(InputError, match="do not lie on an ellipsoid"):
        maximum_likelihood(recording, wu_scenario.array)


@pytest.mark.parametrize("size_T", [0.0, 100e-9, 10e-6])
def test_robust_errors_stay_within_their_standard_errors(wu_runs, wu_scenario, size_T):
    """With and without 5 % of outliers the robust fit's errors have the spread that it tells, near the bound."""
    generator = np.random.default_rng(7)
    squares, told = [], []
    for run in wu_runs[:12]:
        hit = generator.random(run.recording.sample_count) < 0.05
        readings = run.recording.readings_T.copy()
        readings[hit] += size_T * generator.standard_normal((hit.sum(), 4, 3))
        calibration = maximum_likelihood(replace(run.recording, readings_T=readings), wu_scenario.array, robust=True)
        variance = np.diag(bound(run.center_field_T, run.errors, wu_scenario.array, has_scalar=True)).reshape(4, 12)
        squares.append((calibration.errors.to_vector() - run.errors.to_vector())[1:] ** 2 / variance[1:])
        told.append(calibration.standard_errors[1:] ** 2 / variance[1:])
    assert np.sqrt(np.mean(told)) < 1.10
    assert np.mean(squares) == pytest.approx(np.mean(told), abs=0.23)


def test_robust_fit_is_exact_without_noise(noise_free, wu_scenario):
    """Without noise the robust fit gives the errors back, even with a tenth of the samples spoilt."""
    readings = noise_free.recording.readings_T.copy()
    readings[::10] += 1e-6
    found = maximum_likelihood(replace(noise_free.recording, readings_T=readings), wu_scenario.array, robust=True)
    assert_allclose(found.errors.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-13)


NARROW_NOISE_T, NARROW_COUNT = 30e-9, 10_000


def narrow_swing(noise_T, seed):
    """Return errors and the rows of a dive at ±10°; 30 nT of noise in the slopes would pull the biases by 26 sigma."""
    generator = np.random.default_rng(seed)
    errors = SensorErrors(
        1 + 0.02 * generator.uniform(-1, 1, (4, 3)),
        0.02 * generator.uniform(-1, 1, (4, 3)),
        900e-9 * generator.uniform(-1, 1, (4, 3)),
        0.03 * generator.uniform(-1, 1, (4, 3)) * [[0], [1], [1], [1]],
    )
    array = Array.cross(0.5, vector_noise_T=noise_T, scalar_noise_T=noise_T / 10).with_stated_noise()
    return errors, dive(errors, array, generator, np.arange(NARROW_COUNT) / 10)


@pytest.mark.parametrize("kind", ["plain", "robust", "slow", "without scalar"])
def test_noise_does_not_pull_what_a_narrow_swing_hardly_determines(kind):
    """Noise in the slope of the common mode, and in its residual, is no signal: biases stay within standard errors."""
    pulls = []
    for seed in range(2):
        errors, rows = narrow_swing(NARROW_NOISE_T, seed)
        recording = recording_of(rows)
        if kind == "slow":
            recording.scalar_T[np.arange(NARROW_COUNT) % 5 != 0] = np.nan
        if kind == "without scalar":
            recording = replace(recording, scalar_T=None)
        array = Array.cross(0.5, vector_noise_T=NARROW_NOISE_T, scalar_noise_T=NARROW_NOISE_T / 10)
        calibration = maximum_likelihood(recording, array, robust=kind == "robust")
        pull = (calibration.errors.bias_T - errors.bias_T) / calibration.standard_errors[:, 6:9]
        pulls.append(pull[:, 2].mean())
    assert abs(np.mean(pulls)) < 1.7


@pytest.mark.parametrize("overstated", [1, 10])
def test_a_noise_that_is_not_there_pulls_nothing(overstated):
    """What noise would do is taken off as far as the residuals have noise, however much of it is stated."""
    errors, rows = narrow_swing(1e-9, 0)
    array = Array.cross(0.5, vector_noise_T=overstated * 1e-9, scalar_noise_T=overstated * 1e-10)
    calibration = maximum_likelihood(recording_of(rows), array)
    honest = calibration.standard_errors[:, 6:9] / overstated
    assert np.all(np.abs(calibration.errors.bias_T - errors.bias_T) < 4 * honest)
