from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import lfilter
from scipy.stats import norm, t

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.moments import gather, jackknife, lasting_factor
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.fit.published import (
    artificial_vector,
    fast_rotation,
    integrated,
    lossless,
    simplified_linear,
    two_step_linear,
)
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError

EXACT = (artificial_vector, fast_rotation, integrated, two_step_linear, lossless)


def name_of(method):
    """Return the name by which a user calls a method."""
    return method.__name__


@pytest.mark.parametrize("method", (*EXACT, maximum_likelihood), ids=name_of)
def test_noise_free_data_give_the_errors_back(noise_free, wu_scenario, method):
    """Without noise bias is exact to 1e-8 nT, scale factors and angles to 1e-12, in the frame of sensor 1."""
    calibration = method(noise_free.recording, wu_scenario.array)
    found = calibration.errors
    assert calibration.method == method.__name__
    assert_allclose(found.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-17)
    assert_allclose(found.scale_factor, noise_free.errors.scale_factor, rtol=0, atol=1e-12)
    assert_allclose(found.non_orthogonality, noise_free.errors.non_orthogonality, rtol=0, atol=1e-12)
    assert_allclose(found.misalignment, noise_free.errors.misalignment, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", EXACT, ids=name_of)
def test_jackknife_tells_the_spread_of_the_estimate(wu_runs, wu_scenario, method):
    """Over 20 runs the spread of the parameters agrees with the standard errors that are told."""
    found = [method(run.recording, wu_scenario.array) for run in wu_runs]
    truth = wu_scenario.errors.to_vector()
    spread = np.mean([(each.errors.to_vector() - truth) ** 2 for each in found], axis=0)
    told = np.mean([each.standard_errors**2 for each in found], axis=0)
    ratio = spread[told > 0] / told[told > 0]
    assert ratio.mean() == pytest.approx(1.0, abs=0.23)


@pytest.mark.parametrize("method", (*EXACT, maximum_likelihood, simplified_linear), ids=name_of)
def test_without_reference_the_scale_is_fixed_by_convention(noise_free, wu_scenario, method):
    """Without a scalar the determinants have the geometric mean 1, and biases are as exact as with one."""
    calibration = method(replace(noise_free.recording, scalar_T=None), wu_scenario.array)
    assert not calibration.has_scalar_reference
    assert np.linalg.det(calibration.errors.matrix).prod() == pytest.approx(1.0, abs=1e-12)
    left_T = 1e-8 if method is simplified_linear else 1e-16
    assert_allclose(calibration.errors.bias_T, noise_free.errors.bias_T, rtol=0, atol=left_T)


@pytest.mark.parametrize("method", (*EXACT, maximum_likelihood), ids=name_of)
def test_one_sensor_is_a_legal_array(noise_free, method):
    """A single sensor is calibrated as it is within the array."""
    alone = replace(noise_free.recording, readings_T=noise_free.recording.readings_T[:, :1])
    found = method(alone, Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10)).errors
    assert_allclose(found.bias_T, noise_free.errors.bias_T[:1], rtol=0, atol=1e-16)


@pytest.mark.parametrize("method", EXACT, ids=name_of)
def test_samples_without_a_scalar_reading_are_left_out(noise_free, wu_scenario, method):
    """Missing scalar readings leave a noise-free result exact."""
    sparse = np.where(np.arange(noise_free.recording.sample_count) % 3 == 0, noise_free.recording.scalar_T, np.nan)
    found = method(replace(noise_free.recording, scalar_T=sparse), wu_scenario.array).errors
    assert_allclose(found.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-16)


@pytest.mark.parametrize(
    ("method", "tracks"),
    [
        (artificial_vector, True),
        (fast_rotation, True),
        (integrated, False),
        (two_step_linear, False),
        (lossless, True),
        (partial(lossless, as_published=True), False),
    ],
)
def test_who_tracks_a_drift_of_the_field(noise_free, wu_scenario, method, tracks):
    """A drift that the scalar tracks spoils only the methods that hold the intensity constant."""
    swing = 1 + 2e-4 * np.sin(np.arange(noise_free.recording.sample_count) / 20)
    readings = noise_free.errors.distort(noise_free.center_field_T * swing[:, None])
    drifting = replace(noise_free.recording, readings_T=readings, scalar_T=noise_free.recording.scalar_T * swing)
    error = np.abs(method(drifting, wu_scenario.array).errors.bias_T - noise_free.errors.bias_T).max()
    assert error < 1e-17 if tracks else 1e-10 < error < 1e-8


def test_too_few_samples_are_counted(noise_free):
    """Nine samples leave the jackknife nothing to leave out."""
    with pytest.raises(InputError, match="9 samples are too few for the integrated"):
        gather(noise_free.recording.take(slice(0, 9)), "integrated")


def test_a_jackknife_of_means_is_the_covariance_of_a_mean():
    """That of the values over their number, and by Student's t with 19 degrees of freedom so wide that 95 % hold."""
    values = np.random.default_rng(12).normal(size=(20, 3)) @ [[1, 0.5, 0], [0, 2, 0.3], [0, 0, 0.1]]
    assert_allclose(
        jackknife((values.sum(axis=0) - values) / 19),
        (t.isf(0.025, 19) / norm.isf(0.025)) ** 2 * np.cov(values.T) / 20,
        rtol=1e-12,
    )


@pytest.mark.parametrize(("part", "factor"), [(0.0, 1.0), (0.6, 4.0), (0.9, 19.0)])
def test_noise_that_lasts_counts_for_as_long_as_it_does(part, factor):
    """That of a mean of AR(1) noise is (1 + r) / (1 - r) times that of white noise."""
    drawn = np.random.default_rng(5).normal(size=(20_000, 5))
    assert lasting_factor(lfilter([1], [1, -part], drawn, axis=0)) == pytest.approx(factor, rel=0.1)


def test_few_white_groups_hardly_widen():
    """In sixty groups of forty parameters a fortieth of the standard error in the mean, and never a quarter."""
    factors = [lasting_factor(drawn) for drawn in np.random.default_rng(6).normal(size=(200, 60, 40))]
    assert np.mean(factors) < 1.05 and max(factors) < 1.5


def test_standard_errors_hold_what_the_first_order_leaves(wu_run, wu_scenario):
    """Squares of scale factors of 5 % are some hundred nanotesla, of which no jackknife alone knows."""
    first, both = (fit(wu_run.recording, wu_scenario.array) for fit in (simplified_linear, two_step_linear))
    free = first.standard_errors > 0
    deviation = np.abs(first.errors.to_vector() - in_first_frame(wu_run.errors)[0].to_vector())[free]
    assert (deviation / first.standard_errors[free]).max() < 3
    assert (deviation / both.standard_errors[free]).max() > 100


@pytest.mark.parametrize("count", [40, 64, 65, 360])
def test_each_set_of_moments_leaves_out_samples_of_its_own(noise_free, count):
    """All samples are left out once, by sets that leave out as many as they say and one at least."""
    moments = gather(noise_free.recording.take(slice(count)), "lossless")
    left_out = np.bincount(moments.set_without(), minlength=len(moments.joint))
    assert left_out[0] == 0 and left_out[1:].min() > 0 and left_out.sum() == count
    assert (moments.joint[0, -1, -1] - moments.joint[1:, -1, -1]).tolist() == left_out[1:].tolist()
