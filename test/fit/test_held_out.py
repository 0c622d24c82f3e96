"""Residuals of held-out samples: by steps from the fit of all samples as by fits of the others."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from moved_sensors import day_old, turn
from numpy.testing import assert_allclose

from tam_calibration.fit.calibrate import _pool, held_out_residuals
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.problem import Known
from tam_calibration.model.sensor_errors import Residuals


def residuals_of(recording, array, fit, known):
    """Return the residuals of held-out samples."""
    return held_out_residuals(recording, array, fit, fit(recording, array), known)


def are_nearly_equal(stepped, refitted):
    """Check that two sets of residuals are the same to a thousandth."""
    assert_allclose(stepped.sensor_intensity_T, refitted.sensor_intensity_T, rtol=1e-3)
    assert_allclose(stepped.center_intensity_T, refitted.center_intensity_T, rtol=1e-3)
    assert_allclose(stepped.tensor_T_per_m, refitted.tensor_T_per_m, rtol=1e-3)


@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize("count", [60, 360])
def test_a_step_from_the_fit_of_all_samples_leads_to_that_of_the_others(wu_run, wu_scenario, has_scalar, count):
    """With a scalar and without, for many samples and few."""
    recording = wu_run.recording.take(slice(count))
    recording = recording if has_scalar else replace(recording, scalar_T=None)
    stepped, refitted = (
        residuals_of(recording, wu_scenario.array, maximum_likelihood, known) for known in (Known(), None)
    )
    are_nearly_equal(stepped, refitted)


def test_a_prior_counts_in_every_fold(wu_scenario):
    """A narrow turn, of which a day-old calibration tells most."""
    known = Known(day_old(wu_scenario))
    recording = turn(wu_scenario, wu_scenario.errors, 3)
    fit = partial(maximum_a_posteriori, known=known)
    stepped, refitted = (residuals_of(recording, wu_scenario.array, fit, one) for one in (known, None))
    are_nearly_equal(stepped, refitted)


def test_residuals_of_folds_pool_to_those_of_all_samples():
    """Root mean squares of 30 and 10 samples to that of 40."""
    values = np.random.default_rng(2).normal(size=(40, 6))
    parts = [np.sqrt(np.mean(part**2, axis=0)) for part in (values[:30], values[30:], values)]
    first, last, whole = (Residuals(part[:2], float(part[2]), part[3:]) for part in parts)
    pooled = _pool([first, last], np.array([30, 10]))
    assert pooled.sensor_intensity_T == pytest.approx(whole.sensor_intensity_T)
    assert pooled.center_intensity_T == pytest.approx(whole.center_intensity_T)
    assert pooled.tensor_T_per_m == pytest.approx(whole.tensor_T_per_m)


@pytest.mark.parametrize(("samples", "is_held_out"), [(21, False), (24, True)])
def test_eighteen_samples_are_left_to_fit_when_some_are_held_out(wu_run, wu_scenario, samples, is_held_out):
    """With fewer there are no residuals of held-out samples."""
    found = residuals_of(wu_run.recording.take(slice(samples)), wu_scenario.array, maximum_likelihood, None)
    assert (found is not None) == is_held_out
