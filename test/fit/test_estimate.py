"""The figures of one pass against the same worked out sample by sample."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit import calibrate
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.fit.ellipsoid import Normalized, normalize
from tam_calibration.fit.estimate import measure_chi_square, measure_quality
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.fit.maximum_likelihood import estimate, maximum_likelihood
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import residual_series


@pytest.fixture(params=[1, 3], ids=["every scalar", "every third scalar"])
def recording(request, wu_run, monkeypatch):
    """Return Wu's run with some of its scalar readings, in blocks of 70."""
    monkeypatch.setattr("tam_calibration.model.recording.BLOCK", 70)
    scalar = np.where(np.arange(360) % request.param == 0, wu_run.recording.scalar_T, np.nan)
    return replace(wu_run.recording, scalar_T=scalar)


def test_coverage_is_that_of_all_samples(recording, wu_scenario):
    """By the estimated errors."""
    calibration = maximum_likelihood(recording, wu_scenario.array)
    assert calibration.coverage == measure_coverage(field_of(recording, calibration.errors)).fraction


def test_figures_are_those_of_all_samples(recording, wu_scenario):
    """Residuals, mean scalar and chi-square do not know of blocks."""
    array = wu_scenario.array
    errors = estimate(recording, array)
    quality = measure_quality(recording, array, errors, 5e-5)
    series = residual_series(errors, array, recording, 5e-5)
    assert_allclose(quality.after.sensor_intensity_T, np.sqrt(np.nanmean(series.sensor_intensity_T**2, axis=0)))
    assert quality.after.center_intensity_T == pytest.approx(np.sqrt(np.nanmean(series.center_intensity_T**2)))
    assert_allclose(quality.after.tensor_T_per_m, np.sqrt(np.mean(series.tensor_T_per_m**2, axis=0)))
    assert quality.mean_scalar_T == pytest.approx(np.nanmean(recording.scalar_T))
    unit = 5e-5
    data = Normalized(recording, np.zeros((4, 3)), unit, has_scalar=True)
    likelihood = Likelihood(data, array.vector_noise_T / unit, array.scalar_noise_T / unit)
    point = likelihood.linearize(errors.matrix, errors.bias_T / unit)
    assert quality.reduced_chi_square["common_mode"] == pytest.approx(point.common.energy / (point.common.count - 9))
    assert quality.reduced_chi_square["differential"] == pytest.approx(point.between.energy / (360 * 9 - 36), rel=1e-5)
    assert measure_chi_square(recording, array, errors, 5e-5) == quality.reduced_chi_square


def test_normal_equations_are_those_of_all_samples(recording, wu_scenario, monkeypatch):
    """The likelihood that passes over blocks has the information and gradient of the one of all samples at once."""
    data, noise = normalize(recording), np.array([1.0, 2.0, 1.0, 0.5]) * 2e-5
    errors = estimate(recording, wu_scenario.array)
    point = errors.matrix + 1e-6, (errors.bias_T - data.origin_T) / data.radius_T
    one = Likelihood(data, noise, 1e-6).linearize(*point)
    monkeypatch.setattr("tam_calibration.model.recording.BLOCK", 16_384)
    other = Likelihood(normalize(recording), noise, 1e-6).linearize(*point)
    assert_allclose(
        one.both.information, other.both.information, rtol=1e-9, atol=1e-9 * np.abs(other.both.information).max()
    )
    assert_allclose(one.both.score, other.both.score, rtol=1e-6)
    assert one.common.count == other.common.count
    assert one.common.energy == pytest.approx(other.common.energy)


@pytest.mark.parametrize("method", ["maximum_likelihood", "lossless"])
def test_standard_errors_do_not_ask_whether_the_noise_was_stated(wu_run, wu_scenario, method):
    """Where it is estimated from attitudes that jump, 500 times too large at first, they are those of the noise found.

    Also those of a method that takes them from the scatter of the data, which no noise scales.
    """
    unstated = calibrate(wu_run.recording, Array(wu_scenario.array.positions_m), method)
    stated = calibrate(wu_run.recording, unstated.array, method)
    assert unstated.noise_is_estimated and not stated.noise_is_estimated
    assert_allclose(unstated.standard_errors, stated.standard_errors, rtol=0.02)
