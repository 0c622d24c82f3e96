"""Prior and data together: the plain fit where the data say all, never worse than the prior, and attitude as data."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import ChangeRates, in_first_frame, prior_of
from tam_calibration.fit.problem import Known, Problem, posterior_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

ANYTHING = ChangeRates(0.1, 0.1, 0.1, 0.1, 1e-4, 1e-4, 0.1, 0.1)
MOUNT = Rotation.from_rotvec([0.02, -0.03, 0.01]).as_matrix()


def swinging(scenario, limit_deg, seed, **changes):
    """Return full circles of yaw within a limit of pitch and roll."""
    limit = from_degrees(limit_deg)
    motion = Manoeuvre(limit, limit, 30.0)
    return simulate(replace(scenario, motion=motion, sample_count=300, rate_hz=10.0, seed=seed, **changes)).recording


def without_scalar(recording, is_blind):
    """Return the recording, or that without its scalar."""
    return replace(recording, scalar_T=None) if is_blind else recording


@pytest.mark.parametrize(("before", "now"), [(False, False), (True, True), (True, False)])
def test_where_the_data_say_all_it_is_the_plain_fit(wu_scenario, wu_run, before, now):
    """Beside a prior of anything, with and without scalar; also where only the recording has one."""
    array = wu_scenario.array.with_stated_noise()
    prior = prior_of(maximum_likelihood(without_scalar(wu_run.recording, before), array), None, None, ANYTHING)
    recording = without_scalar(simulate(replace(wu_scenario, seed=3)).recording, now)
    plain, both = maximum_likelihood(recording, array), posterior_of(recording, array, Known(prior))
    difference = np.abs(both.errors.to_vector() - plain.errors.to_vector())
    assert (difference <= 1e-4 * plain.standard_errors + 1e-12).all()
    assert_allclose(np.sqrt(np.diag(both.covariance)).reshape(4, 12), plain.standard_errors, rtol=1e-3, atol=1e-15)


@pytest.mark.parametrize("is_blind", [False, True])
def test_it_is_never_worse_than_the_prior(wu_scenario, wu_run, is_blind):
    """No variance grows, and at three degrees of tilt the errors stay within what is told."""
    array = wu_scenario.array.with_stated_noise()
    prior = prior_of(maximum_likelihood(wu_run.recording, array), None, None)
    both = posterior_of(without_scalar(swinging(wu_scenario, 3, 1), is_blind), array, Known(prior))
    variance = np.diag(both.covariance)
    assert (variance <= np.diag(prior.covariance) * (1 + 1e-9)).all()
    error = (both.errors.to_vector() - wu_scenario.errors.to_vector()).ravel()
    assert (np.abs(error) <= 4.5 * np.sqrt(variance) + 1e-15).all()


def test_noise_that_is_stated_too_large_is_no_reason_to_refuse(wu_scenario):
    """A sensor known to 5 % and 3 µT, swung by 3°: with 300 times its noise the answer is within what was known."""
    errors = SensorErrors(
        np.array([[0.93, 0.95, 0.96]]),
        np.array([[0.03, -0.02, 0.02]]),
        np.array([[-2e-6, 2e-6, 1.5e-6]]),
        np.zeros((1, 3)),
    )
    array = Array(np.zeros((1, 3)), np.full(1, 1e-9), 1e-10).with_stated_noise()
    scenario = replace(wu_scenario, array=array, errors=errors)
    before = maximum_likelihood(simulate(scenario).recording, array)
    deviation = np.repeat([0.05, 0.05, 3e-6, 0.0], 3)
    prior = prior_of(replace(before, errors=SensorErrors.none(1), covariance=np.diag(deviation**2)), None, None)
    motion = Manoeuvre(from_degrees(3), from_degrees(3), 30.0)
    turn = simulate(replace(scenario, motion=motion, sample_count=2000, rate_hz=10.0)).recording.take(slice(600))
    both = posterior_of(turn, replace(array, vector_noise_T=300 * array.vector_noise_T), Known(prior))
    off = (both.errors.to_vector() - errors.to_vector()).ravel()
    assert (np.abs(off) <= deviation).all()


def test_an_intensity_below_zero_is_none(wu_scenario):
    """A bias that moved by more than the field, unknown to the prior, without a scalar: a refusal says what to do."""
    array = Array(np.zeros((1, 3)), np.full(1, 1e-9), 1e-10).with_stated_noise()
    scenario = replace(wu_scenario, array=array, errors=SensorErrors.from_vector(wu_scenario.errors.to_vector()[:1]))
    prior = prior_of(maximum_likelihood(without_scalar(simulate(scenario).recording, True), array), None, None)
    turn = without_scalar(swinging(scenario, 5, 6), True).take(slice(100))
    mean = turn.readings_T.mean(axis=0)
    away = replace(turn, readings_T=turn.readings_T - 60e-6 * mean / np.linalg.norm(mean))
    with pytest.raises(Refused, match="sensors that cannot be"):
        posterior_of(away, array, Known(prior))


@pytest.mark.parametrize("mounting_error", [None, from_degrees(0.001)])
def test_errors_beside_attitude_lie_within_what_is_told(wu_scenario, mounting_error):
    """The mean square over 8 runs is one; where the mounting is known, the frame is that of the attitude."""
    errors = SensorErrors.from_matrix(wu_scenario.errors.matrix @ MOUNT, wu_scenario.errors.bias_T)
    truth = errors if mounting_error else in_first_frame(errors)[0]
    noise = from_degrees(0.2)
    array = replace(wu_scenario.array.with_stated_noise(), attitude_noise=noise, mounting_error=mounting_error)
    squares = []
    for seed in range(8):
        recording = swinging(wu_scenario, 30, seed, errors=errors, attitude=AttitudeChannel(noise))
        found = maximum_a_posteriori(recording, array, Known())
        free = found.standard_errors > 0
        assert free.sum() == (48 if mounting_error else 45)
        ratio = (found.errors.to_vector() - truth.to_vector())[free] / found.standard_errors[free]
        squares.append(np.mean(ratio**2))
    assert np.mean(squares) == pytest.approx(1.0, abs=0.3)
    assert ("recorded" in found.frame) == bool(mounting_error)


@pytest.mark.parametrize(("mounting_deg", "is_frame"), [(0.56, True), (0.59, False)])
def test_a_mounting_that_is_known_too_little_makes_no_frame(wu_scenario, mounting_deg, is_frame):
    """A full turn is calibrated in the frame of sensor 1 then, as where nothing is known of the mounting."""
    noise = from_degrees(0.05)
    array = replace(wu_scenario.array, attitude_noise=noise, mounting_error=from_degrees(mounting_deg))
    found = calibrate(swinging(wu_scenario, 80, 7, attitude=AttitudeChannel(noise)), array)
    assert ("recorded" in found.frame) == is_frame
    assert (found.standard_errors[0, 9:].max() > 0) == is_frame


def test_attitude_closes_what_a_narrow_turn_leaves_open(wu_scenario):
    """At five degrees of tilt the worst standard errors shrink to less than half of those without it."""
    noise = from_degrees(0.01)
    recording = swinging(wu_scenario, 5, 4, attitude=AttitudeChannel(noise))
    array = wu_scenario.array.with_stated_noise()
    without = np.sqrt(np.diag(posterior_of(recording, array, Known()).covariance))
    beside = np.sqrt(np.diag(posterior_of(recording, replace(array, attitude_noise=noise), Known()).covariance))
    assert (beside <= without * (1 + 1e-9)).all()
    assert beside[8] < without[8] / 2


def test_a_frame_that_was_found_by_attitude_stays_known(wu_scenario, wu_run):
    """Beside such a prior a dive without attitude gives errors in its frame, with the uncertainty of its turn."""
    errors = SensorErrors.from_matrix(wu_scenario.errors.matrix @ MOUNT, wu_scenario.errors.bias_T)
    known = from_degrees(0.01)
    array = replace(wu_scenario.array.with_stated_noise(), attitude_noise=known, mounting_error=known)
    pier = simulate(replace(wu_scenario, errors=errors, attitude=AttitudeChannel(known))).recording
    before = maximum_a_posteriori(pier, array, Known())
    dive = maximum_a_posteriori(swinging(wu_scenario, 5, 7, errors=errors), array, Known(prior_of(before, None, None)))
    assert dive.frame == before.frame
    assert (np.abs(dive.errors.misalignment - errors.misalignment) < 4.5 * dive.standard_errors[:, 9:]).all()


def test_a_model_of_the_field_tells_the_scale(wu_scenario, wu_run):
    """Without scalar the intensity of a place gives it, to the 140 nT of the model."""
    array = wu_scenario.array.with_stated_noise()
    model_T = wu_scenario.site_field_T
    found = maximum_a_posteriori(replace(wu_run.recording, scalar_T=None), array, Known(None, model_T))
    error = found.standard_errors[:, :3] / found.errors.scale_factor
    assert_allclose(error, 140e-9 / np.linalg.norm(model_T), rtol=0.02)
    assert found.has_scalar_reference


def test_noise_that_is_not_stated_is_scaled_before_data_and_prior_are_weighed(wu_scenario, wu_run):
    """The standard errors are those of the stated noise, to some per cent."""
    array = wu_scenario.array
    prior = maximum_likelihood(wu_run.recording, array)
    recording = swinging(wu_scenario, 10, 5)
    stated = calibrate(recording, array, prior=prior)
    estimated = calibrate(recording, replace(array, vector_noise_T=None), prior=prior)
    assert estimated.noise_is_estimated and not stated.noise_is_estimated
    free = stated.standard_errors > 0
    assert_allclose(estimated.standard_errors[free], stated.standard_errors[free], rtol=0.1)


@pytest.mark.parametrize(
    ("parameter", "step", "is_refused"),
    [(1, -1.2, True), (1, 990.0, False), (1, 1000.0, True), (4, 1.5, False), (4, 1.6, True)],
)
def test_steps_to_sensors_that_cannot_be_are_refused(wu_scenario, wu_run, parameter, step, is_refused):
    """Of a scale factor below zero or of a thousand, and of axes more than a right angle askew: what to do is said."""
    problem = Problem.of(wu_run.recording, wu_scenario.array.with_stated_noise(), Known())
    steps = np.zeros(48)
    steps[12 + parameter] = step - problem.start.errors.to_vector()[1, parameter] * (parameter == 4)
    with pytest.raises(Refused, match="turn the array further") if is_refused else nullcontext():
        problem.moved(problem.start, steps)
