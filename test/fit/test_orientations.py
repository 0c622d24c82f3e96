"""Sensors that are mounted in any of the 24 orientations are calibrated, named as such, stored and read again."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.fit import calibrate
from tam_calibration.gap import diagnose
from tam_calibration.model.sensor_errors import ORIENTATIONS, SensorErrors
from tam_calibration.report.calibration_rows import parameter_rows
from tam_calibration.results import read_calibration, write_calibration
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


def mounted(*orientations):
    """Return what is simulated of a cross whose sensors 2 to 4 are mounted in these orientations."""
    scenario = read_scenario("wu_table_1")
    errors = scenario.errors
    parts = errors.scale_factor, errors.non_orthogonality, errors.bias_T, errors.misalignment
    return simulate(replace(scenario, errors=SensorErrors(*parts, np.stack([np.eye(3), *orientations]))))


@pytest.mark.parametrize("first", [3, 9, 18])
def test_any_orientation_is_calibrated(first, tmp_path):
    """The matrices are found within five standard errors, whatever angles describe them; the file gives them back."""
    made = mounted(*ORIENTATIONS[first : first + 3])
    calibration = calibrate(made.recording, made.scenario.array)
    assert np.isfinite(calibration.standard_errors).all() and not calibration.warnings
    true = SensorErrors.from_matrix(made.errors.matrix, made.errors.bias_T)
    assert_array_equal(calibration.errors.orientation, true.orientation)
    difference = (calibration.errors.to_vector() - true.to_vector()).ravel()
    difference[9:12] = 0
    difference = np.where(np.abs(difference) > np.pi, 2 * np.pi - np.abs(difference), difference)
    deviation = np.maximum(calibration.standard_errors.ravel(), 1e-12)
    assert (np.abs(difference) < 5 * deviation).all()
    write_calibration(tmp_path / "calibration.yaml", calibration)
    again = read_calibration(tmp_path / "calibration.yaml")
    assert_allclose(again.errors.matrix, calibration.errors.matrix, atol=1e-12)
    assert_array_equal(again.errors.orientation, calibration.errors.orientation)


def test_an_orientation_is_told():
    """The page has a row with the axes, which an array without orientations does not have."""
    made = mounted(np.eye(3), ORIENTATIONS[0], np.array([[0, 0, -1], [0, 1, 0], [1, 0, 0]]))
    *_, row = parameter_rows(calibrate(made.recording, made.scenario.array))
    assert row == ["mounted with its axes along the array's", "x y z", "x y z", "x y z", "-z y x"]
    straight = mounted(*[np.eye(3)] * 3)
    assert len(parameter_rows(calibrate(straight.recording, straight.scenario.array))) == 12


def test_an_orientation_leaves_no_gap():
    """The diagnosis of sensors that are mounted turned says what it says of others: noise alone."""
    made = mounted(*ORIENTATIONS[[4, 11, 17]])
    assert diagnose(made.recording, made.scenario.array).causes == ()
