from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit import calibrate
from tam_calibration.fit.consistency import find_warnings, require_one_calibration, require_one_sphere
from tam_calibration.fit.scale import sphere_of_most
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused


def test_sphere_of_most_ignores_the_others():
    """With three tenths of the points on another sphere the first one is found."""
    generator = np.random.default_rng(3)
    directions = generator.standard_normal((1000, 3))
    points = np.array([0.1, -0.2, 0.05]) + directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points[300:600] += [0.0, 0.5, 0.4]
    center, radius = sphere_of_most(points)
    assert_allclose(center, [0.1, -0.2, 0.05], atol=1e-3)
    assert radius == pytest.approx(1.0, abs=1e-3)


def test_readings_that_leave_their_sphere_for_a_time_are_refused(wu_run):
    """A bias of 20 µT in the middle of the run is told with its times, without any fit."""
    readings = wu_run.recording.readings_T.copy()
    readings[144:216] += 20e-6
    with pytest.raises(Refused, match=r"between (144|180)\.0 and (179|215)\.0 s: something magnetic"):
        require_one_sphere(replace(wu_run.recording, readings_T=readings))


def test_steady_readings_pass(wu_run):
    """Scale errors of some per cent, the same throughout, are no change."""
    require_one_sphere(wu_run.recording)


@pytest.mark.parametrize(("count", "bent", "warns"), [(3, 0.0, True), (3, 0.3, False), (2, 0.0, False)])
def test_sensors_in_one_line_are_a_warning(wu_run, count, bent, warns):
    """Three of them could have told a gradient; a gradiometer of two is not asked for one."""
    places = [[0.3 * sensor, bent * (sensor == 2), 0.0] for sensor in range(count)]
    array = Array(places, wu_run.scenario.array.vector_noise_T[:count], wu_run.scenario.array.scalar_noise_T)
    some = replace(wu_run.recording, readings_T=wu_run.recording.readings_T[:, :count])
    told = [warning for warning in calibrate(some, array).warnings if "in one line" in warning]
    assert bool(told) is warns


@pytest.mark.parametrize(
    ("samples", "value", "warns"),
    [(1000, 1.95, False), (1000, 2.05, True), (41, 2.4, False), (41, 2.6, True)],
)
def test_a_residual_beyond_the_stated_noise_is_a_warning(wu_run, wu_scenario, samples, value, warns):
    """Above twice its variance, or six deviations of χ² where samples are few: of 32 beyond nine, 1.5."""
    calibration = calibrate(wu_run.recording, wu_scenario.array)
    told = replace(calibration, samples=samples, reduced_chi_square={"differential": value})
    assert any("times the stated noise" in one for one in find_warnings(wu_run.recording, told)) == warns


@pytest.mark.parametrize(
    ("samples", "value", "warns"), [(1000, 0.24, True), (1000, 0.26, False), (80, 0.24, False), (9000, 1.0, False)]
)
def test_a_stated_noise_twice_too_large_is_a_warning(wu_run, wu_scenario, samples, value, warns):
    """It says what to do; where samples are few, six deviations of χ² are more than there can be."""
    calibration = calibrate(wu_run.recording, wu_scenario.array)
    told = replace(calibration, samples=samples, reduced_chi_square={"common_mode": value})
    found = [one for one in find_warnings(wu_run.recording, told) if "standard errors are" in one]
    assert bool(found) == warns and all("leave it out to have it estimated" in one for one in found)


def test_an_intensity_that_is_not_of_the_earth_is_told_in_microtesla(wu_run, wu_scenario):
    """Beside the range that it should lie in."""
    calibration = replace(calibrate(wu_run.recording, wu_scenario.array), intensity_T=250e-6)
    with pytest.raises(Refused, match="the fitted intensity of 250 µT is outside"):
        require_one_calibration(wu_run.recording, calibration)
