"""What else may have changed than what is named widens the standard errors as far as the readings leave it open."""

from dataclasses import replace

import numpy as np
import pytest
from moved_sensors import SIZES, moved

from tam_calibration.fit import calibrate
from tam_calibration.fit.posterior import Known
from tam_calibration.fit.resolved_prior import resolve
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.attitude import Manoeuvre


def narrow_turn(scenario, errors, seed):
    """Return full circles at three degrees of pitch and roll."""
    motion = Manoeuvre(from_degrees(3.0), from_degrees(3.0), 60.0)
    return simulate(replace(scenario, errors=errors, motion=motion, sample_count=300, rate_hz=5.0, seed=seed)).recording


def test_other_errors_of_a_sensor_may_have_changed_with_its_scale(wu_scenario, array, prior):
    """A narrow turn leaves that open, and the standard errors hold for it; no other sensor loses by it."""
    errors = moved(wu_scenario.errors, "scale factor", 1)
    resolved = resolve(narrow_turn(wu_scenario, errors, 3), array, Known(prior))
    [several] = [each for each in resolved.unnamed if each.name == "several errors of sensor 2"]
    assert several.probability > 0.05
    wider = np.sqrt(np.diag(several.covariance)).reshape(-1, 12)
    assert (wider[1, :9] > 0).all() and not wider[[0, 2, 3]].any()


def test_a_turn_all_round_leaves_little_open(wu_scenario, array, prior):
    """The other errors of the sensor are told to be as they were, to a fiftieth of what has changed."""
    errors = moved(wu_scenario.errors, "scale factor", 1)
    made = simulate(replace(wu_scenario, errors=errors, seed=3)).recording
    several, faster = resolve(made, array, Known(prior)).unnamed
    wider = np.sqrt(np.diag(several.covariance)).reshape(-1, 12)[1, :6]
    assert (wider < SIZES["scale factor"] / 50).all() and faster.probability < 1e-9


@pytest.mark.parametrize("seed", range(1, 7))
def test_sensors_that_all_warmed_unseen(wu_scenario, prior, seed):
    """A narrow turn names one or two of their errors; the others are within the standard errors all the same."""
    vector = wu_scenario.errors.to_vector()
    vector[:, :3] += 30e-6 * np.random.default_rng(seed).normal(size=(len(vector), 3))
    errors = SensorErrors.from_vector(vector)
    found = calibrate(narrow_turn(wu_scenario, errors, seed), wu_scenario.array, prior=prior)
    off = np.abs(found.errors.to_vector() - vector)[:, :9]
    assert found.update.moved and (off < 4.5 * found.standard_errors[:, :9]).all()


def test_an_unchanged_array_loses_nothing(wu_scenario, prior):
    """Standard errors beside a prior that the readings agree with stay within a hundredth."""
    made = narrow_turn(wu_scenario, wu_scenario.errors, 4)
    found = calibrate(made, wu_scenario.array, prior=prior)
    assert not found.update.moved
    share = np.sqrt(1 - found.update.data_share[:, :9]) * found.update.prior_standard_errors[:, :9]
    assert (found.standard_errors[:, :9] <= 1.01 * share).all()
