"""Calibrations at a site with a gradient: the errors come out as they do in a uniform field, and the gradient too."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.gap.calibration_with_effects import calibrate_with_effects
from tam_calibration.gap.diagnose import diagnose
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import from_degrees
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

SHAPE = np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])
GRADIENT = 100e-9 * SHAPE / np.linalg.norm(SHAPE)
AWAY_M = np.array([0.3, -0.2, 0.9])


@pytest.fixture(scope="module")
def scenario(wu_scenario):
    """Return Wu's run at a site with 100 nT/m, with attitude."""
    return replace(wu_scenario, attitude=AttitudeChannel(), site_gradient_T_per_m=GRADIENT)


def calibrated(recording, array):
    """Return the calibration with the gradient of the site."""
    return calibrate_with_effects(recording, array, ["ambient_gradient"])


def gradient_of(calibration):
    """Return the components xx, xy, xz, yy, yz of the gradient, and their standard errors."""
    (found,) = calibration.effects[0].contributions
    names = [f"gradient {'xyz'[row]}{'xyz'[column]}" for row, column in zip(TENSOR_ROWS, TENSOR_COLUMNS, strict=True)]
    return np.array([[part[name] for name in names] for part in (found.values, found.standard_errors)])


def turned_by(recording, angle_deg):
    """Return the recording with the attitude of an instrument that is mounted turned."""
    mount = Rotation.from_rotvec(from_degrees(angle_deg) * np.array([0.6, -0.64, 0.48]))
    return replace(recording, attitude=(Rotation.from_quat(recording.attitude) * mount).as_quat())


@pytest.mark.parametrize("position_m", [None, AWAY_M])
def test_errors_lie_within_their_standard_errors(scenario, position_m):
    """Over 12 runs the spread of all parameters and of the gradient is the one that is told."""
    away = replace(scenario, array=replace(scenario.array, scalar_position_m=position_m))
    free = np.r_[:9, 12:48]
    scores, gradients = [], []
    for seed in range(12):
        run = simulate(replace(away, seed=seed))
        calibration = calibrated(turned_by(run.recording, 3.0), away.array)
        error = (calibration.errors.to_vector() - run.errors.to_vector()).ravel()[free]
        scores.append(error @ np.linalg.solve(calibration.covariance[np.ix_(free, free)], error))
        found, standard_errors = gradient_of(calibration)
        gradients.append(((found - GRADIENT[TENSOR_ROWS, TENSOR_COLUMNS]) / standard_errors) ** 2)
    assert abs(np.mean(scores) - 45) < 6.9
    assert np.mean(gradients) == pytest.approx(1, abs=0.46)


def test_a_diagnosis_finds_the_gradient_by_an_attitude_that_is_mounted_askew(scenario):
    """As a calibration with its name does; an inverse attitude is not used."""
    recording = simulate(scenario).recording
    gap = diagnose(turned_by(recording, 8.0), scenario.array)
    assert (gap.verdict, gap.named) == ("explained", ("ambient_gradient",))
    inverse = replace(recording, attitude=recording.attitude * [-1, -1, -1, 1])
    assert "ambient_gradient" not in diagnose(inverse, scenario.array).named


def test_the_price_is_small(wu_run, wu_scenario, scenario):
    """Five more parameters cost less than 2 % of the standard errors on the whole sphere."""
    uniform = calibrate(wu_run.recording, wu_scenario.array).standard_errors
    calibration = calibrated(simulate(scenario).recording, scenario.array)
    assert (calibration.standard_errors[1:] / uniform[1:]).max() < 1.02


@pytest.mark.parametrize("motion", [None, Manoeuvre(from_degrees(30), from_degrees(30), 60.0)])
def test_attitude_errors_of_a_degree_do_not_spoil_it(scenario, motion):
    """With 1° of noise and a mount turned by 1° the errors grow by less than 15 % in 100 nT/m: tolerance of the fit."""
    base = scenario if motion is None else replace(scenario, motion=motion)
    ratios = []
    for seed in range(10):
        run = simulate(replace(base, seed=seed, attitude=AttitudeChannel(from_degrees(1.0))))
        calibration = calibrated(turned_by(run.recording, 1.0), base.array)
        error = calibration.errors.to_vector() - run.errors.to_vector()
        ratios.append((error[1:] / calibration.standard_errors[1:]) ** 2)
    assert np.sqrt(np.mean(ratios)) < 1.15


def test_one_call_judges_without_the_gradient(scenario):
    """Residuals, held-out ones too, are at the floor, and nothing is warned of; without the effect it is."""
    recording = simulate(scenario).recording
    calibration = calibrated(recording, scenario.array)
    floor = calibration.floor.tensor_rmse_T_per_m
    assert calibration.in_sample.tensor_rmse_T_per_m == pytest.approx(floor, rel=0.05)
    assert calibration.held_out.tensor_rmse_T_per_m == pytest.approx(floor, rel=0.06)
    assert calibration.warnings == ()
    assert any("above the noise floor" in warning for warning in calibrate(recording, scenario.array).warnings)


def test_a_large_gradient_is_not_taken_for_noise(scenario):
    """With ±15° and 1 µT/m what the sensors differ in does not make a recording that suffices look too noisy."""
    narrow = replace(
        scenario, motion=Manoeuvre(from_degrees(15), from_degrees(15), 60.0), site_gradient_T_per_m=10 * GRADIENT
    )
    run = simulate(narrow)
    calibration = calibrated(run.recording, narrow.array)
    error = calibration.errors.to_vector()[1:] - run.errors.to_vector()[1:]
    assert np.sqrt(np.mean((error / calibration.standard_errors[1:]) ** 2)) < 1.5
    assert calibration.intensity_T == pytest.approx(np.linalg.norm(narrow.site_field_T), abs=1e-10)


def test_missing_attitude_is_told(wu_run, wu_scenario):
    """Without attitude the reason is given."""
    with pytest.raises(InputError, match="ambient_gradient cannot be fitted: it needs the attitude"):
        calibrated(wu_run.recording, wu_scenario.array)


def test_attitudes_that_were_written_otherwise_are_told(scenario):
    """Quaternions that turn the other way do not hold the field still in the world."""
    recording = simulate(scenario).recording
    wrong = replace(recording, attitude=Rotation.from_quat(recording.attitude).inv().as_quat())
    with pytest.raises(InputError, match="the recorded attitude turns the world into the array: write the inverse"):
        calibrated(wrong, scenario.array)


def test_levers_that_are_too_short_are_told(scenario):
    """One sensor at the centre sees no gradient."""
    recording = simulate(scenario).recording
    alone = replace(recording, readings_T=recording.readings_T[:, :1])
    with pytest.raises(Refused, match="all sensors are at the centre of rotation"):
        calibrated(alone, Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10))
