from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

from tam_calibration.fit.published import lossless
from tam_calibration.model.recording import Recording
from tam_calibration.simulation import simulate


def test_the_published_step_gives_the_errors_back(noise_free, wu_scenario):
    """Without noise biases are exact to 1e-8 nT, angles and scales to 1e-12."""
    found = lossless(noise_free.recording, wu_scenario.array, as_published=True).errors
    difference = np.abs(found.to_vector() - noise_free.errors.to_vector())
    assert (difference <= np.tile(np.repeat([1e-12, 1e-12, 1e-17, 1e-12], 3), (4, 1))).all()


def test_programming_ends_at_the_linear_solution(wu_run, wu_scenario):
    """The published step 1, as printed on eq. 12 for each sensor by itself, agrees with the linear one to 1e-6 nT."""
    found = lossless(wu_run.recording, wu_scenario.array, as_published=True).errors.bias_T
    for sensor, bias_T in enumerate(found):
        points = wu_run.recording.readings_T[:, sensor] / 5e-5

        def residuals(unknowns, points=points):
            xx, yy, zz, xy, xz, yz, *center = unknowns
            shifted = points - center
            return np.einsum("ni,ij,nj->n", shifted, [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], shifted) - 1

        start = [1, 1, 1, 0, 0, 0, *points.mean(axis=0)]
        tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15}
        programmed = scipy.optimize.least_squares(residuals, start, method="lm", **tight).x[6:]
        assert_allclose(5e-5 * programmed, bias_T, rtol=0, atol=1e-15)


def test_one_sensor_has_no_alignment(wu_run, wu_scenario):
    """A single sensor's covariance is that which it has within the array, but for how long the noise lasts.

    That is told by all sensors together, here to 5 % of a standard error.
    """
    recording = replace(wu_run.recording, readings_T=wu_run.recording.readings_T[:, :1])
    array = replace(wu_scenario.array, positions_m=np.zeros((1, 3)), vector_noise_T=np.array([1e-9]))
    within = lossless(wu_run.recording, wu_scenario.array)
    assert_allclose(lossless(recording, array).standard_errors, within.standard_errors[:1], rtol=0.05)


def test_samples_that_share_their_error_count_once(wu_scenario):
    """Every sample sixteen times over tells no more than once."""
    one = simulate(replace(wu_scenario, sample_count=1024)).recording
    many = Recording(np.arange(16 * 1024.0), np.repeat(one.readings_T, 16, axis=0), np.repeat(one.scalar_T, 16))
    once, repeated = (lossless(recording, wu_scenario.array).standard_errors for recording in (one, many))
    assert_allclose(repeated, once, rtol=1e-6)


def test_without_reference_the_intensity_is_that_of_the_restored_readings(noise_free, wu_scenario):
    """On the scale that the convention gives; with a reference it is the scalar's mean."""
    blind = lossless(replace(noise_free.recording, scalar_T=None), wu_scenario.array)
    length = np.linalg.norm(blind.errors.restore(noise_free.recording.readings_T), axis=2)
    assert_allclose(length, blind.intensity_T, rtol=1e-3)
    assert np.sqrt(np.mean(length**2)) == pytest.approx(blind.intensity_T, rel=1e-7)
