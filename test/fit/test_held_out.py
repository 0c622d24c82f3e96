"""Residuals of held-out samples: by steps from the fit of all samples as by fits of the others."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from moved_sensors import day_old, turn
from numpy.testing import assert_allclose

from tam_calibration import read_scenario, simulate
from tam_calibration.fit.calibrate import held_out_residuals
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.problem import Known


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


@pytest.mark.parametrize("every", [200, 210])
@pytest.mark.parametrize("known", [Known(), None])
def test_folds_without_a_reading_of_a_slow_scalar_tell_nothing_of_the_intensity(every, known):
    """Twenty readings in 4000 samples, of a field that varies by 100 nT, of which some folds have none."""
    scenario = read_scenario("tumble_100_hz")
    made, rng = simulate(scenario), np.random.default_rng(3)
    field = scenario.errors.restore(made.recording.readings_T).mean(axis=1)
    scalar_T = 50e-6 + 1e-7 * np.sin(np.linspace(0, 2 * np.pi, len(field)))
    field *= (scalar_T / np.linalg.norm(field, axis=1))[:, None]
    noise = rng.normal(size=made.recording.readings_T.shape) * scenario.array.vector_noise_T[:, None]
    slow = np.where(np.arange(len(field)) % every, np.nan, scalar_T + scenario.array.scalar_noise_T * rng.normal())
    recording = replace(made.recording, readings_T=scenario.errors.distort(field) + noise, scalar_T=slow)
    found = residuals_of(recording, scenario.array, maximum_likelihood, known)
    assert found.center_intensity_T < 2e-9


@pytest.mark.parametrize(("samples", "is_held_out"), [(21, False), (24, True)])
def test_eighteen_samples_are_left_to_fit_when_some_are_held_out(wu_run, wu_scenario, samples, is_held_out):
    """With fewer there are no residuals of held-out samples."""
    found = residuals_of(wu_run.recording.take(slice(samples)), wu_scenario.array, maximum_likelihood, None)
    assert (found is not None) == is_held_out
