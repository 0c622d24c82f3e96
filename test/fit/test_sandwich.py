"""The covariance of the lossless fit against the jackknife, which asks nothing of the equations."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit import ellipsoid
from tam_calibration.fit.alignment import field_products, procrustes
from tam_calibration.fit.lossless import lossless
from tam_calibration.fit.moments import gather, jackknife
from tam_calibration.fit.scale import free_scale
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate


def leave_each_out(recording):
    """Return the covariance of the jackknife that leaves out one sample at a time."""
    moments = gather(recording, "lossless", groups=recording.sample_count)
    center = ellipsoid.center_of(moments.quartic)
    unmix = ellipsoid.square_root(ellipsoid.shape_about(moments.quartic, center))
    matrix = np.linalg.inv(unmix) @ procrustes(field_products(moments.joint, unmix, center)[:, :, 0])
    if recording.scalar_T is None:
        matrix = matrix * free_scale(matrix)[:, None, None, None]
    bias_T = moments.data.origin_T + moments.data.radius_T * center
    every = SensorErrors.from_matrix(matrix.reshape(-1, 3, 3), bias_T.reshape(-1, 3)).to_vector()
    return jackknife(every.reshape(len(matrix), -1)[1:])


@pytest.mark.parametrize("has_scalar", [True, False])
def test_it_is_the_jackknife_over_single_samples(wu_run, wu_scenario, has_scalar):
    """Variances differ by a few per cent, which is the share of a sample in the fit, correlations by less."""
    check_covariance(wu_run.recording if has_scalar else replace(wu_run.recording, scalar_T=None), wu_scenario.array)


def test_it_is_the_jackknife_where_axes_are_far_from_rectangular(wu_scenario):
    """Angles of 20 degrees between the axes, scales of 0.7 to 1.3: no matrix may be taken for its transpose."""
    rng = np.random.default_rng(7)
    skew = from_degrees(20) * rng.choice([-1, 1], (4, 3))
    errors = replace(wu_scenario.errors, scale_factor=rng.uniform(0.7, 1.3, (4, 3)), non_orthogonality=skew)
    check_covariance(simulate(replace(wu_scenario, errors=errors)).recording, wu_scenario.array)


def check_covariance(recording, array):
    """Compare the covariance of the lossless fit with the jackknife's."""
    covariance, expected = lossless(recording, array).covariance, leave_each_out(recording)
    free = np.delete(np.arange(48), [9, 10, 11])
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))[np.ix_(free, free)]
    assert_allclose(covariance[np.ix_(free, free)] / scale, expected[np.ix_(free, free)] / scale, atol=0.05)


def test_one_sensor_has_no_alignment(wu_run, wu_scenario):
    """The equations of the ellipsoid alone give the covariance of a single sensor, as within the array."""
    recording = replace(wu_run.recording, readings_T=wu_run.recording.readings_T[:, :1])
    array = replace(wu_scenario.array, positions_m=np.zeros((1, 3)), vector_noise_T=np.array([1e-9]))
    within = lossless(wu_run.recording, wu_scenario.array)
    assert_allclose(lossless(recording, array).standard_errors, within.standard_errors[:1], rtol=1e-9)


def test_samples_that_share_their_error_count_once(wu_scenario):
    """Every sample sixteen times over tells no more than once."""
    one = simulate(replace(wu_scenario, sample_count=1000)).recording
    many = Recording(np.arange(16_000.0), np.repeat(one.readings_T, 16, axis=0), np.repeat(one.scalar_T, 16))
    once, repeated = (lossless(recording, wu_scenario.array).standard_errors for recording in (one, many))
    assert_allclose(repeated, once, rtol=0.01)
