"""What else may have changed than what is named widens the standard errors as far as the readings leave it open."""

from dataclasses import replace

import numpy as np
import pytest
from moved_sensors import SIZES, lone, moved, turn

from tam_calibration.fit import calibrate
from tam_calibration.fit.contradiction import Difference, candidates_of, small_changes
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.prior_changes import update_prior
from tam_calibration.fit.problem import Known, posterior_of
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Manoeuvre


def narrow_turn(scenario, errors, seed):
    """Return full circles at three degrees of pitch and roll."""
    motion = Manoeuvre(from_degrees(3.0), from_degrees(3.0), 60.0)
    return simulate(replace(scenario, errors=errors, motion=motion, sample_count=300, rate_hz=5.0, seed=seed)).recording


def test_other_errors_of_a_sensor_may_have_changed_with_its_scale(wu_scenario, array, prior):
    """A narrow turn leaves that open, and the standard errors hold for it; no other sensor loses by it."""
    errors = moved(wu_scenario.errors, "scale factor", 1)
    resolved = update_prior(narrow_turn(wu_scenario, errors, 3), array, Known(prior))
    [several] = [each for each in resolved.unnamed if each.name == "several errors of sensor 2"]
    assert several.probability > 0.05
    wider = np.sqrt(np.diag(several.covariance)).reshape(-1, 12)
    assert (wider[1, :9] > 0).all() and not wider[[0, 2, 3]].any()


def test_a_turn_all_round_leaves_little_open(wu_scenario, array, prior):
    """The other errors of the sensor are told to be as they were, to a fiftieth of what has changed."""
    errors = moved(wu_scenario.errors, "scale factor", 1)
    made = simulate(replace(wu_scenario, errors=errors, seed=3)).recording
    several, faster = update_prior(made, array, Known(prior)).unnamed
    wider = np.sqrt(np.diag(several.covariance)).reshape(-1, 12)[1, :6]
    assert (wider < SIZES["scale factor"] / 50).all() and faster.probability < 1e-9


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_sensors_that_all_warmed_unseen(wu_scenario, prior, seed):
    """A narrow turn names one or two of their errors; the others are within the standard errors all the same."""
    vector = wu_scenario.errors.to_vector()
    vector[:, :3] += 30e-6 * np.random.default_rng(seed).normal(size=(len(vector), 3))
    errors = SensorErrors.from_vector(vector)
    found = calibrate(narrow_turn(wu_scenario, errors, seed), wu_scenario.array, prior=prior)
    off = np.abs(found.errors.to_vector() - vector)[:, :9]
    assert found.update.moved and (off < 4.5 * found.standard_errors[:, :9]).all()


def test_an_unchanged_array_loses_nothing(wu_scenario, array, prior):
    """Standard errors with a prior that the readings agree with stay within a hundredth of those of a plain update."""
    made = narrow_turn(wu_scenario, wu_scenario.errors, 4)
    found = calibrate(made, wu_scenario.array, prior=prior)
    plain = maximum_a_posteriori(made, array, Known(prior)).standard_errors
    assert not found.update.moved and (found.standard_errors <= 1.01 * plain).all()


def test_a_hint_of_a_change_widens_a_prior(wu_scenario, array, prior):
    """In proportion to its odds; chance widens no standard error of a clean turn by a hundredth."""
    candidates = candidates_of(prior, True)
    small, larger = (small_changes(lone(prior, evidence), candidates).covariance[30, 30] for evidence in (2.0, 5.0))
    square = [(lone(prior, evidence).score[30] / 1e18) ** 2 for evidence in (2.0, 5.0)]
    assert larger / square[1] == pytest.approx(np.exp(3) * small / square[0], rel=0.3)
    difference = Difference.of(prior, posterior_of(turn(wu_scenario, wu_scenario.errors, 3), array, Known(prior)))
    widened = np.diag(small_changes(difference, candidates).covariance)
    free = np.diag(prior.covariance) > 0
    assert (widened[free] < 0.02 * np.diag(prior.covariance)[free]).all()
