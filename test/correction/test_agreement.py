"""The corrected field against the scalar magnetometer's reading."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.correction.acceptance import ScalarAgreement
from tam_calibration.fit import calibrate
from tam_calibration.sources.dipole import Dipole

SCALAR_T = np.full(10, 50e-6)


def agreement_of(residual_T):
    """Return the agreement of ten samples with these residuals."""
    agreement = ScalarAgreement()
    agreement.add((SCALAR_T + residual_T)[:, None] * [0.6, 0.0, -0.8], SCALAR_T)
    return agreement


def test_residual_is_a_root_mean_square_in_any_number_of_parts():
    """Samples without field or scalar do not count; without any there is no residual."""
    agreement = agreement_of(3e-9)
    field = np.full((4, 3), 20e-6)
    agreement.add(field, np.full(4, np.nan))
    agreement.add(np.full((4, 3), np.nan), np.full(4, 50e-6))
    assert agreement.samples == 10 and agreement.residual_T == pytest.approx(3e-9, rel=1e-6)
    assert np.isnan(ScalarAgreement().residual_T) and not ScalarAgreement().is_wrong


@pytest.mark.parametrize(("share", "is_wrong"), [(0.4, False), (0.6, True)])
def test_most_samples_must_be_off_by_a_hundredth(share, is_wrong):
    """A part of a survey may pass close to a source; a calibration of another array is wrong all the time."""
    off = np.where(np.arange(10) < 10 * share, 1, 0)
    assert agreement_of(0.0101 * SCALAR_T * off).is_wrong is is_wrong
    assert not agreement_of(0.0099 * SCALAR_T * off).is_wrong


def test_residual_is_judged_by_noise_and_by_what_the_fit_left(recording, cross):
    """Above three times the larger of both a new calibration is advised."""
    calibration = calibrate(recording, cross)
    least = max(calibration.floor.center_intensity_T, calibration.in_sample.center_intensity_T)
    assert not agreement_of(2.99 * least).is_doubtful(calibration)
    assert agreement_of(3.01 * least).is_doubtful(calibration)
    left = replace(calibration, in_sample=replace(calibration.in_sample, center_intensity_T=2 * least))
    assert not agreement_of(5.9 * least).is_doubtful(left)
    assert agreement_of(5.9 * least).sentence(left).endswith("nT")
    assert agreement_of(5.9 * least).sentence(calibration).endswith(": calibrate again")


def agreement_in(field_T, calibration, true_errors, change_T=0.0):
    """Return the agreement in fields (N, 4, 3) at the sensors, whose bias x of the second has changed."""
    readings_T = true_errors.distort(field_T)
    readings_T[:, 1, 0] += change_T
    agreement = ScalarAgreement()
    agreement.add(calibration.apply(readings_T), SCALAR_T)
    return agreement


@pytest.mark.parametrize("distance_m", [1.5, 2.0, 3.0])
def test_near_a_source_the_scalar_does_not_compare(recording, cross, true_errors, distance_m):
    """Its field bends within the array: the sentence says so, and advises no new calibration there."""
    calibration = calibrate(recording, cross)
    direction = np.random.default_rng(3).normal(size=(10, 3))
    places = distance_m * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    dipole = [Dipole(place, np.array([60.0, -90.0, 200.0])) for place in places]
    main = SCALAR_T[0] * np.array([0.6, 0.0, -0.8])
    fields = np.array([main + each.field_T(cross.positions_m) for each in dipole])
    at_center = [np.linalg.norm(main + each.field_T(np.zeros((1, 3)))) for each in dipole]
    fields *= SCALAR_T[0] / np.reshape(at_center, (-1, 1, 1))
    agreement = agreement_in(fields, calibration, true_errors)
    assert agreement.residual_T > 3 * calibration.floor.center_intensity_T and not agreement.is_doubtful(calibration)
    assert agreement.sentence(calibration).endswith("near a source they do not compare; away from any, calibrate again")


def test_a_bias_that_moved_is_no_source(recording, cross, true_errors):
    """It makes a gradient too, of its own size."""
    calibration = calibrate(recording, cross)
    direction = np.random.default_rng(4).normal(size=(10, 1, 3))
    fields = np.tile(SCALAR_T[0] * direction / np.linalg.norm(direction, axis=2, keepdims=True), (1, 4, 1))
    agreement = agreement_in(fields, calibration, true_errors, 100e-9)
    assert agreement.is_doubtful(calibration) and agreement.sentence(calibration).endswith(": calibrate again")
