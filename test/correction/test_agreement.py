"""The corrected field against the scalar magnetometer's reading."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.correction.acceptance import ScalarAgreement
from tam_calibration.fit import calibrate

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
