"""What errors of a calibration make of corrected readings, and that a track does not take them for something else."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.localization.source_fit import errors_of
from tam_calibration.localization.targets import find_targets, path_in
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.sources.dipole import Dipole

from .conftest import EARTH_T

WRECK = Dipole(np.array([30.0, 2.6, -2.5]), np.array([48.5, -80.8, 129.3]))
TIME_S = np.arange(150) * 0.4


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return the calibration of a run with 1 nT of noise."""
    return maximum_likelihood(recording, cross)


def seen(errors, array, noise_T, sources, seed):
    """Return the recording of a platform that goes east at 1 m/s and sways, by sensors with errors."""
    sway = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(TIME_S, [0.2, 0.33, 0.5]) + np.arange(3)))
    points = np.outer(TIME_S, [1.0, 0, 0])[:, None] + np.einsum("nij,kj->nki", sway.as_matrix(), array.positions_m)
    world = EARTH_T + sum((source.field_T(points) for source in sources), np.zeros_like(points))
    readings = errors.distort(np.einsum("nji,nkj->nki", sway.as_matrix(), world))
    noise = noise_T * np.random.default_rng(seed).normal(size=readings.shape)
    return Recording(TIME_S, readings + noise, attitude=sway.as_quat())


def found(recording, calibration):
    """Return the targets of a straight track."""
    path = path_in(recording, np.array([1.0, 0, 0]), 0.0)
    return find_targets(recording, calibration, path).targets


@pytest.mark.parametrize("is_alternating", [False, True])
def test_errors_have_the_covariance_that_the_calibration_says(calibration, is_alternating):
    """To first order corrected readings differ as errors drawn from the covariance make them, whatever the field."""
    fields = 5e-5 * np.random.default_rng(1).normal(size=(30, 4, 3))
    errors = errors_of(calibration, fields, is_alternating=is_alternating)
    assert errors.shape[2] <= 48
    small, rows = 1e-3, []
    for column in np.linalg.cholesky(calibration.covariance + 1e-30 * np.eye(48)).T:
        vector = calibration.errors.to_vector()
        off = SensorErrors.from_vector(vector + small * column.reshape(vector.shape))
        readings = calibration.errors.distort(fields)
        if is_alternating:
            readings, off = readings - calibration.errors.bias_T, replace(off, bias_T=np.zeros((4, 3)))
        rows.append((off.restore(readings) - fields).ravel() / small)
    expected, found = np.array(rows).T @ np.array(rows), errors.reshape(360, -1) @ errors.reshape(360, -1).T
    assert_allclose(found, expected, atol=2e-3 * expected.max())


def assert_at_the_wreck(target):
    """Check that a target is the wreck within four and a half standard errors."""
    assert (np.abs(target.position_m - WRECK.position_m) < 4.5 * target.standard_errors_m).all()


def test_a_pass_less_noisy_than_the_calibration_run_is_answered(calibration, true_errors, cross):
    """At a tenth of its noise the calibration's errors are no misfit, but a part of the standard errors."""
    recording = seen(true_errors, cross, 1e-10, [WRECK], 2)
    exact = replace(calibration, covariance=np.zeros_like(calibration.covariance))
    [[target], [alone]] = [found(recording, one) for one in (calibration, exact)]
    assert_at_the_wreck(target)
    assert_at_the_wreck(alone)
    assert target.standard_errors_m.max() < 0.02 and target.misfit < 1.5 and not target.is_extended
    assert target.standard_errors_m[2] > alone.standard_errors_m[2]


def test_a_gain_that_is_off_does_no_harm(calibration, true_errors, cross):
    """By thirty standard errors: the target stays within its errors."""
    vector = true_errors.to_vector()
    vector[1, 0] += 30 * calibration.standard_errors[1, 0]
    [target] = found(seen(SensorErrors.from_vector(vector), cross, 1e-10, [WRECK], 4), calibration)
    assert_at_the_wreck(target)


def test_with_sensor_1_askew_no_exact_dipole_is_told(calibration, true_errors, cross):
    """By 0.6°: no uniform field shows it, so the covariance does not hold it. The target is told as no dipole."""
    turn = Rotation.from_rotvec(from_degrees(0.6) * np.array([0.6, 0.8, 0.0])).as_matrix()
    askew = SensorErrors.from_matrix(true_errors.matrix @ turn, true_errors.bias_T)
    [target] = found(seen(askew, cross, 1e-10, [WRECK], 3), calibration)
    assert target.is_extended
    assert_at_the_wreck(target)


def test_nothing_passed_is_no_target(calibration, true_errors, cross):
    """Errors of the calibration and noise make none."""
    assert found(seen(true_errors, cross, 1e-10, [], 5), calibration) == []
