"""Fits at a site with a gradient: the errors come out as they do in a uniform field, and the gradient beside them."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.recorded_attitude import (
    find_turn,
    likely_turn,
)
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre, ScalarReference, Tumble

SHAPE = np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])
GRADIENT = 100e-9 * SHAPE / np.linalg.norm(SHAPE)
AWAY_M = np.array([0.3, -0.2, 0.9])


@pytest.fixture(scope="module")
def scenario(wu_scenario):
    """Return Wu's run at a site with 100 nT/m, with attitude."""
    return replace(wu_scenario, attitude=AttitudeChannel(), site_gradient_T_per_m=GRADIENT)


def silent(scenario):
    """Return the scenario without noise."""
    return replace(scenario, array=replace(scenario.array, vector_noise_T=None, scalar_noise_T=None))


def turned_by(recording, angle_deg):
    """Return the recording with the attitude of an instrument that is mounted turned."""
    mount = Rotation.from_rotvec(from_degrees(angle_deg) * np.array([0.6, -0.64, 0.48]))
    return replace(recording, attitude=(Rotation.from_quat(recording.attitude) * mount).as_quat())


@pytest.mark.parametrize(
    ("method", "position_m", "turn_deg"),
    [("maximum_likelihood", None, 0.0), ("maximum_likelihood", AWAY_M, 3.0), ("robust", AWAY_M, 3.0)],
)
def test_noise_free_data_give_errors_and_gradient_back(scenario, method, position_m, turn_deg):
    """Exact to 1e-4 nT and nT/m, wherever the scalar is and however the attitude's instrument is mounted."""
    away = replace(scenario, array=replace(scenario.array, scalar_position_m=position_m))
    run = simulate(silent(away))
    recording = turned_by(run.recording, turn_deg)
    calibration = maximum_likelihood(recording, away.array, robust=method == "robust", ambient_gradient=True)
    assert_allclose(calibration.errors.bias_T, run.errors.bias_T, rtol=0, atol=1e-13)
    assert_allclose(calibration.errors.scale_factor, run.errors.scale_factor, rtol=0, atol=2e-9)
    assert_allclose(calibration.errors.misalignment, run.errors.misalignment, rtol=0, atol=2e-9)
    assert_allclose(calibration.ambient_gradient.tensor_T_per_m, GRADIENT, rtol=0, atol=1e-13)
    assert calibration.in_sample.tensor_rmse_T_per_m < 1e-12


def test_without_scalar_the_gradient_is_found_on_the_same_scale(scenario):
    """Without a reference all but the scale is exact; the gradient is told in the unit of the fitted intensity."""
    run = simulate(silent(scenario))
    calibration = maximum_likelihood(replace(run.recording, scalar_T=None), scenario.array, ambient_gradient=True)
    scale = calibration.intensity_T / np.linalg.norm(scenario.site_field_T)
    assert_allclose(calibration.errors.bias_T, run.errors.bias_T, rtol=0, atol=1e-13)
    assert_allclose(calibration.ambient_gradient.tensor_T_per_m, scale * GRADIENT, rtol=0, atol=1e-13)


@pytest.mark.parametrize("position_m", [None, AWAY_M])
def test_errors_lie_within_their_standard_errors(scenario, position_m):
    """Over 12 runs the spread of all parameters and of the gradient is the one that is told."""
    away = replace(scenario, array=replace(scenario.array, scalar_position_m=position_m))
    free = np.r_[:9, 12:48]
    scores, gradients = [], []
    for seed in range(12):
        run = simulate(replace(away, seed=seed))
        calibration = maximum_likelihood(run.recording, away.array, ambient_gradient=True)
        error = (calibration.errors.to_vector() - run.errors.to_vector()).ravel()[free]
        scores.append(error @ np.linalg.solve(calibration.covariance[np.ix_(free, free)], error))
        found = calibration.ambient_gradient
        gradients.append(((found.tensor_T_per_m - GRADIENT) / found.standard_errors_T_per_m) ** 2)
    assert abs(np.mean(scores) - 45) < 6.9
    assert np.mean(gradients) == pytest.approx(1, abs=0.46)


def test_the_price_is_small(wu_run, wu_scenario, scenario):
    """Five more parameters cost less than 2 % of the standard errors on the whole sphere."""
    uniform = maximum_likelihood(wu_run.recording, wu_scenario.array).standard_errors
    calibration = maximum_likelihood(simulate(scenario).recording, scenario.array, ambient_gradient=True)
    assert (calibration.standard_errors[1:] / uniform[1:]).max() < 1.02


@pytest.mark.parametrize("motion", [None, Manoeuvre(from_degrees(30), from_degrees(30), 60.0)])
def test_attitude_errors_of_a_degree_do_not_spoil_it(scenario, motion):
    """With 1° of noise and a mount turned by 1° the errors grow by less than 15 % in 100 nT/m: tolerance of the fit."""
    base = scenario if motion is None else replace(scenario, motion=motion)
    ratios = []
    for seed in range(10):
        run = simulate(replace(base, seed=seed, attitude=AttitudeChannel(from_degrees(1.0))))
        calibration = maximum_likelihood(turned_by(run.recording, 1.0), base.array, ambient_gradient=True)
        error = calibration.errors.to_vector() - run.errors.to_vector()
        ratios.append((error[1:] / calibration.standard_errors[1:]) ** 2)
    assert np.sqrt(np.mean(ratios)) < 1.15


def test_one_call_judges_without_the_gradient(scenario):
    """Residuals, held-out ones too, are at the floor, and nothing is warned of; without the option it is."""
    recording = simulate(scenario).recording
    calibration = calibrate(recording, scenario.array, ambient_gradient=True)
    floor = calibration.floor.tensor_rmse_T_per_m
    assert calibration.in_sample.tensor_rmse_T_per_m == pytest.approx(floor, rel=0.05)
    assert calibration.held_out.tensor_rmse_T_per_m == pytest.approx(floor, rel=0.06)
    assert calibration.warnings == ()
    assert any("taken to have a gradient" in statement for statement in calibration.statements)
    assert any("above the noise floor" in warning for warning in calibrate(recording, scenario.array).warnings)


def test_a_large_gradient_is_not_taken_for_noise(scenario):
    """With ±15° and 1 µT/m what the sensors differ in does not make a recording that suffices look too noisy."""
    narrow = replace(
        scenario, motion=Manoeuvre(from_degrees(15), from_degrees(15), 60.0), site_gradient_T_per_m=10 * GRADIENT
    )
    run = simulate(narrow)
    calibration = calibrate(run.recording, narrow.array, ambient_gradient=True)
    error = calibration.errors.to_vector()[1:] - run.errors.to_vector()[1:]
    assert np.sqrt(np.mean((error / calibration.standard_errors[1:]) ** 2)) < 1.5
    assert calibration.intensity_T == pytest.approx(np.linalg.norm(narrow.site_field_T), abs=1e-10)


def test_an_unstated_noise_scales_the_gradients_standard_errors(scenario):
    """Estimated noise gives the standard errors that stated noise gives, to its sampling error."""
    slow = replace(scenario, motion=Tumble(np.pi / 30))
    recording = simulate(slow).recording
    unknown = replace(slow.array, vector_noise_T=None)
    stated, estimated = (
        maximum_likelihood(recording, array, ambient_gradient=True).ambient_gradient.standard_errors_T_per_m
        for array in (slow.array, unknown)
    )
    assert_allclose(estimated, stated, rtol=0.1)


def test_a_slow_scalar_at_the_centre_is_interpolated_in_a_gradient_too(scenario):
    """Gradient and interpolation work together: errors within their standard errors with one reading in five."""
    slow = replace(scenario, motion=Tumble(np.pi / 30), scalar=ScalarReference(rate_hz=0.2), sample_count=1000)
    run = simulate(slow)
    calibration = maximum_likelihood(run.recording, slow.array, ambient_gradient=True)
    free = np.r_[:9, 12:48]
    error = (calibration.errors.to_vector() - run.errors.to_vector()).ravel()[free]
    score = error @ np.linalg.solve(calibration.covariance[np.ix_(free, free)], error)
    assert abs(score - 45) < 4 * np.sqrt(2 * 45)


def test_missing_attitude_is_told(wu_run, wu_scenario):
    """Without attitude the reason is given, and what would mend it."""
    with pytest.raises(InputError, match="the recording has no attitude: record it, or calibrate where the field is"):
        calibrate(wu_run.recording, wu_scenario.array, ambient_gradient=True)


def test_attitudes_of_something_else_are_told(scenario):
    """Quaternions that turn the other way do not hold the field still in the world."""
    recording = simulate(scenario).recording
    wrong = replace(recording, attitude=Rotation.from_quat(recording.attitude).inv().as_quat())
    with pytest.raises(InputError, match="Attitude must be the turn from the array to the world"):
        maximum_likelihood(wrong, scenario.array, ambient_gradient=True)


def test_levers_that_are_too_short_leave_the_gradient_open(scenario):
    """One sensor at the centre sees no gradient; with the scalar away from it, three components of five."""
    recording = simulate(scenario).recording
    alone = replace(recording, readings_T=recording.readings_T[:, :1])
    for position_m in (None, AWAY_M):
        array = Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10, position_m)
        with pytest.raises(InputError, match="do not tell an ambient gradient from the errors"):
            maximum_likelihood(alone, array, ambient_gradient=True)


def test_attitudes_about_few_axes_leave_the_gradient_open(scenario):
    """With pitch and roll of a degree a gradient is hardly to be told from biases."""
    narrow = replace(scenario, motion=Manoeuvre(from_degrees(0.5), from_degrees(0.5), 60.0))
    with pytest.raises(InputError, match=r"do not tell an ambient gradient from the errors|turn the array"):
        maximum_likelihood(simulate(narrow).recording, narrow.array, ambient_gradient=True)


def test_methods_that_cannot_are_told(scenario):
    """A closed form has no place for a gradient."""
    with pytest.raises(InputError, match="lossless takes the field for uniform: maximum_likelihood or robust can fit"):
        calibrate(simulate(scenario).recording, scenario.array, "lossless", ambient_gradient=True)


def test_a_gradient_that_the_data_leave_open_is_infinite():
    """One that they tell is as uncertain as what it shares with the rows makes it."""
    information = np.diag(np.append(np.full(48, 3.0), np.zeros(5)))
    assert np.isinf(np.diag(inverted(information, np.eye(53)))[48:]).all()
    information[48:, 48:] = 2 * np.eye(5)
    information[0, 48] = information[48, 0] = 1.0
    variances = np.diag(inverted(information, np.eye(53)))
    assert_allclose(variances[48:], np.append(1 / (2 - 1 / 3), np.full(4, 1 / 2)))
    assert_allclose(1 / variances[:48], np.append(3 - 1 / 2, np.full(47, 3.0)))


def test_of_an_array_that_hardly_turned_the_mount_is_near_to_none():
    """At rest, about one axis, and of one sample; turned about two it is what the readings say, here 120°."""
    rng = np.random.default_rng(6)
    mount = Rotation.from_rotvec(np.radians(120) / np.sqrt(3) * np.ones(3)).as_matrix()
    field = np.array([0.1, 0.4, -0.9])
    for turns in (np.zeros((50, 1)), np.linspace(0, 2, 50)[:, None], np.zeros((1, 1))):
        attitude = Rotation.from_euler("z", turns)
        likely = likely_turn(attitude.inv().apply(field), attitude.as_matrix())
        assert_allclose(likely, np.eye(3), atol=1e-6)
        with pytest.raises(InputError, match="about two axes"):
            find_turn(attitude.inv().apply(field), attitude.as_matrix())
    attitude = Rotation.random(50, rng)
    seen = attitude.inv().apply(field)
    assert_allclose(likely_turn(seen @ mount, attitude.as_matrix()), mount, atol=1e-9)
