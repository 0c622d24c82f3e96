from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit import METHODS, calibrate
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

EXACT = [method for method in METHODS if method != "simplified_linear"]


def test_a_first_order_model_stays_above_the_floor(wu_run, wu_scenario):
    """Zhang's model of first order leaves ten times the floor of what the exact models remove, and warns."""
    calibration = calibrate(wu_run.recording, wu_scenario.array, "simplified_linear")
    assert 5 < calibration.in_sample.tensor_rmse_T_per_m / calibration.floor.tensor_rmse_T_per_m < 20
    assert calibration.warnings


@pytest.mark.parametrize("method", EXACT)
def test_calibration_reaches_the_noise_floor_in_and_out_of_sample(wu_run, wu_scenario, method):
    """Wu's 8172 nT/m fall to the floor of 6 nT/m, on held-out blocks too."""
    calibration = calibrate(wu_run.recording, wu_scenario.array, method)
    floor = calibration.floor.tensor_rmse_T_per_m
    assert calibration.method == method
    assert calibration.before.tensor_rmse_T_per_m > 1000 * floor
    assert calibration.in_sample.tensor_rmse_T_per_m == pytest.approx(floor, rel=0.05)
    assert calibration.held_out.tensor_rmse_T_per_m == pytest.approx(floor, rel=0.06)
    assert calibration.held_out.tensor_rmse_T_per_m > calibration.in_sample.tensor_rmse_T_per_m
    assert calibration.warnings == ()


@pytest.mark.parametrize("method", METHODS)
def test_a_scalar_that_misses_a_varying_field_widens_the_errors(method):
    """Wu's turntable as the paper has it: one intensity for all 72 poses, in a field that varies by 8 nT."""
    run = simulate(read_scenario("wu_turntable"))
    recording = replace(run.recording, scalar_T=np.full(72, 52185e-9))
    calibration = calibrate(recording, run.scenario.array, method)
    free = calibration.standard_errors > 1e-12  # else it is a definition of the frame
    deviation = calibration.errors.to_vector() - in_first_frame(run.errors)[0].to_vector()
    assert np.abs(deviation[free] / calibration.standard_errors[free]).max() < 4


def test_residuals_before_are_those_of_the_paper(wu_runs, wu_scenario):
    """Mean residuals of 20 raw runs are Wu's 1035, 1333, 762, 1684 nT and 8172 nT/m within 3 %."""
    before = [METHODS["lossless"](run.recording, wu_scenario.array).before for run in wu_runs]
    sensors = np.mean([1e9 * residual.sensor_intensity_T for residual in before], axis=0)
    assert sensors == pytest.approx([1035, 1333, 762, 1684], rel=0.03)
    assert np.mean([1e9 * residual.tensor_rmse_T_per_m for residual in before]) == pytest.approx(8172, rel=0.03)


def test_unknown_method_lists_the_known_ones(wu_run, wu_scenario):
    """A misspelled method is answered with the names there are."""
    with pytest.raises(InputError, match="no method 'ellipse': choose one of maximum_likelihood, robust, lossless"):
        calibrate(wu_run.recording, wu_scenario.array, "ellipse")


def test_array_of_another_size_is_told(wu_run):
    """A recording of four sensors does not fit an array of one."""
    with pytest.raises(InputError, match="the recording has 4 sensors, the array 1"):
        calibrate(wu_run.recording, Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10))


def test_a_constant_axis_is_named(wu_run, wu_scenario):
    """An axis that is not connected is told by sensor and letter."""
    readings = wu_run.recording.readings_T.copy()
    readings[:, 2, 1] = 1e-5
    with pytest.raises(Refused, match="sensor 3 axis y reads the same value"):
        calibrate(replace(wu_run.recording, readings_T=readings), wu_scenario.array)


def test_microtesla_taken_for_tesla_is_caught(wu_run, wu_scenario):
    """Readings a million times too large are refused with the likely cause."""
    wrong = replace(
        wu_run.recording, readings_T=1e6 * wu_run.recording.readings_T, scalar_T=1e6 * wu_run.recording.scalar_T
    )
    with pytest.raises(InputError, match="µT given as T"):
        calibrate(wrong, wu_scenario.array)


def test_a_short_recording_has_no_held_out_figures(noise_free, wu_scenario):
    """Twenty samples cannot spare a fifth, and the calibration says nothing about unseen ones."""
    assert calibrate(noise_free.recording.take(slice(0, 20)), wu_scenario.array).held_out is None


@pytest.mark.parametrize(("samples", "is_said"), [(159, True), (160, False)])
def test_few_samples_say_that_they_do_not_tell_slow_noise(wu_run, wu_scenario, samples, is_said):
    """Their standard errors hold for white noise; whether it is white shows from ten samples in each block on."""
    found = calibrate(wu_run.recording.take(slice(samples)), wu_scenario.array)
    assert any("whether their noise is white" in note for note in found.notes) == is_said
