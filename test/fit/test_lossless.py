from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from numpy.testing import assert_allclose

from tam_calibration.fit.published import lossless
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.simulation import simulate


@pytest.mark.parametrize("as_published", [False, True])
def test_noise_free_data_give_the_errors_back(noise_free, wu_scenario, as_published):
    """Without noise biases are exact to 1e-8 nT, angles and scales to 1e-12."""
    found = lossless(noise_free.recording, wu_scenario.array, as_published=as_published).errors
    assert_allclose(found.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-17)
    assert_allclose(found.scale_factor, noise_free.errors.scale_factor, rtol=0, atol=1e-12)
    assert_allclose(found.non_orthogonality, noise_free.errors.non_orthogonality, rtol=0, atol=1e-12)
    assert_allclose(found.misalignment, noise_free.errors.misalignment, rtol=0, atol=1e-12)


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


def test_a_drift_that_the_scalar_tracks_spoils_only_the_published_step(noise_free, wu_scenario):
    """Without noise a drift of the field leaves the corrected step 1 exact and shifts the published one."""
    swing = 1 + 2e-4 * np.sin(np.arange(noise_free.recording.sample_count) / 20)
    readings = noise_free.errors.distort(noise_free.center_field_T * swing[:, None])
    drifting = replace(noise_free.recording, readings_T=readings, scalar_T=noise_free.recording.scalar_T * swing)
    truth = noise_free.errors.bias_T
    assert_allclose(lossless(drifting, wu_scenario.array).errors.bias_T, truth, rtol=0, atol=1e-17)
    published = lossless(drifting, wu_scenario.array, as_published=True).errors.bias_T
    assert 1e-10 < np.abs(published - truth).max() < 1e-8


def test_covariance_tells_the_spread_of_the_estimate(wu_scenario):
    """Over 60 runs the spread of the parameters agrees with the standard errors that are told."""
    errors, told = [], []
    for seed in range(60):
        run = simulate(replace(wu_scenario, seed=seed))
        calibration = lossless(run.recording, wu_scenario.array)
        errors.append(calibration.errors.to_vector() - run.errors.to_vector())
        told.append(calibration.standard_errors)
    spread, told = np.mean(np.square(errors), axis=0), np.mean(np.square(told), axis=0)
    ratio = spread[told > 0] / told[told > 0]
    assert ratio.mean() == pytest.approx(1.0, abs=4 * np.sqrt(2 / 60 / 15))


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


def test_samples_without_a_scalar_reading_are_left_out(noise_free, wu_scenario):
    """Missing scalar readings leave a noise-free result exact."""
    sparse = np.where(np.arange(noise_free.recording.sample_count) % 3 == 0, noise_free.recording.scalar_T, np.nan)
    found = lossless(replace(noise_free.recording, scalar_T=sparse), wu_scenario.array).errors
    assert_allclose(found.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-17)


def test_without_reference_the_scale_is_fixed_by_convention(noise_free, wu_scenario):
    """Without a scalar the determinants have the geometric mean 1."""
    found = lossless(replace(noise_free.recording, scalar_T=None), wu_scenario.array).errors
    assert np.linalg.det(found.matrix).prod() == pytest.approx(1.0, abs=1e-12)
    assert_allclose(found.bias_T, noise_free.errors.bias_T, rtol=0, atol=1e-16)


def test_too_few_samples_are_counted(noise_free, wu_scenario):
    """Nine samples leave the jackknife nothing to leave out."""
    with pytest.raises(InputError, match="9 samples are too few"):
        lossless(noise_free.recording.take(slice(0, 9)), wu_scenario.array)


def test_a_mirrored_sensor_is_named(noise_free, wu_scenario):
    """A sensor with one axis reversed is refused by number."""
    readings = noise_free.recording.readings_T.copy()
    readings[:, 1, 1] *= -1
    with pytest.raises(InputError, match="sensor 2 is a mirror image of sensors 1, 3 and 4"):
        lossless(replace(noise_free.recording, readings_T=readings), wu_scenario.array)


def test_without_reference_the_intensity_is_that_of_the_restored_readings(noise_free, wu_scenario):
    """On the scale that the convention gives; with a reference it is the scalar's mean."""
    blind = lossless(replace(noise_free.recording, scalar_T=None), wu_scenario.array)
    length = np.linalg.norm(blind.errors.restore(noise_free.recording.readings_T), axis=2)
    assert_allclose(length, blind.intensity_T, rtol=1e-3)
    assert np.sqrt(np.mean(length**2)) == pytest.approx(blind.intensity_T, rel=1e-7)
