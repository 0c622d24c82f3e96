"""A calibration is graded by what speaks against it; each doubt says what to do."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.fit import calibrate
from tam_calibration.fit.consistency import doubts_of
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import Residuals


def scaled(residuals: Residuals, factor: float) -> Residuals:
    """Return larger residuals."""
    return Residuals(
        factor * residuals.sensor_intensity_T,
        factor * residuals.center_intensity_T,
        factor * residuals.tensor_T_per_m,
    )


@pytest.fixture(scope="module")
def calibration(wu_run, wu_scenario):
    """Return the calibration of a sound run."""
    return calibrate(wu_run.recording, wu_scenario.array)


def test_a_sound_run_is_good(calibration):
    """Its first line gives the residual on held-out samples beside the noise floor."""
    quality = calibration.quality
    assert quality.grade == "good" and quality.reasons == quality.next == ()
    residual, floor = (1e9 * each.tensor_rmse_T_per_m for each in (calibration.held_out, calibration.floor))
    assert str(quality) == (
        f"Good: tensor residual {residual:.4g} nT/m on held-out samples, noise floor {floor:.4g} nT/m"
    )


def test_a_residual_above_the_floor_is_doubted(wu_run, calibration):
    """The largest are named, with what to do."""
    large = replace(calibration, held_out=scaled(calibration.floor, 2))
    [doubt] = doubts_of(wu_run.recording, large)
    assert doubt == (
        "the residual is above the noise floor (|B| of sensor 1 2 times, |B| of sensor 2 2 times): look for the cause "
        "with tam diagnose"
    )
    quality = replace(large, warnings=(doubt,)).quality
    assert quality.grade == "doubtful" and quality.reasons == (doubt,)
    assert quality.next == ("look for the cause with tam diagnose",)
    assert str(quality).startswith("Doubtful: tensor residual 11.98 nT/m") and str(quality).endswith(f"; {doubt}")


def test_held_out_residuals_are_what_counts(wu_run, calibration):
    """A fit that is good only on its own samples is doubted."""
    assert doubts_of(wu_run.recording, replace(calibration, held_out=scaled(calibration.in_sample, 5)))


@pytest.mark.parametrize(
    ("samples", "value", "doubted"),
    [(1000, 1.15, False), (1000, 1.18, True), (41, 1.42, False), (41, 1.44, True)],
)
def test_a_residual_within_a_tenth_and_chance_is_not_doubted(wu_run, calibration, samples, value, doubted):
    """Three standard deviations of a root mean square of so many samples: 0.067 of 1000, 0.33 of 41."""
    told = replace(calibration, samples=samples, reduced_chi_square={"differential": value**2})
    assert any("between the sensors" in one for one in doubts_of(wu_run.recording, told)) == doubted


def test_low_coverage_is_doubted_with_advice(wu_run, wu_scenario, calibration):
    """The sentence says how much was seen, and where the field should point next."""
    narrow = replace(wu_run.recording, readings_T=wu_run.recording.readings_T[:1].repeat(360, axis=0))
    [doubt] = [one for one in doubts_of(narrow, calibration) if "sphere" in one]
    assert doubt.startswith("the field visited only ") and ": turn the array so that the field points " in doubt


@pytest.mark.parametrize(("bias_error_T", "doubted"), [(0.05e-9, False), (5e-9, True)])
def test_large_standard_errors_are_doubted(wu_run, calibration, bias_error_T, doubted):
    """Standard errors count against the noise of a corrected sample."""
    covariance = np.zeros((48, 48))
    covariance[6, 6] = bias_error_T**2
    assert bool(doubts_of(wu_run.recording, replace(calibration, covariance=covariance))) == doubted


@pytest.mark.parametrize(("count", "bent", "warns"), [(3, 0.0, True), (3, 0.3, False), (2, 0.0, False)])
def test_sensors_in_one_line_are_a_warning(wu_run, count, bent, warns):
    """Three of them could have told a gradient; a gradiometer of two is not asked for one."""
    places = [[0.3 * sensor, bent * (sensor == 2), 0.0] for sensor in range(count)]
    array = Array(places, wu_run.scenario.array.vector_noise_T[:count], wu_run.scenario.array.scalar_noise_T)
    some = replace(wu_run.recording, readings_T=wu_run.recording.readings_T[:, :count])
    told = [warning for warning in calibrate(some, array).warnings if "on one line" in warning]
    assert bool(told) is warns


def test_one_sensor_is_judged_by_its_intensity(wu_run):
    """Without a gradient the first line speaks of |B|; without a scalar it says that the scale is unknown."""
    array = Array(np.zeros((1, 3)), np.array([1e-9]))
    one = replace(wu_run.recording, readings_T=wu_run.recording.readings_T[:, :1], scalar_T=None)
    quality = calibrate(one, array).quality
    assert str(quality).startswith("Good: |B| residual ") and quality.headline.endswith("the absolute scale is unknown")


def test_a_residual_that_had_to_be_accepted_is_bad(calibration):
    """It was refused, and somebody overruled that."""
    accepted = replace(calibration, accepted=("residual",), warnings=("the fit leaves 5000 nT of sensor 1",))
    assert str(accepted.quality).startswith("Bad: tensor residual")


@pytest.mark.parametrize("angle_deg", [3.0, 30.0, 90.0, 180.0])
def test_a_sensor_1_that_is_mounted_askew_is_told(wu_run, wu_scenario, angle_deg):
    """All others then are turned by as much; a few degrees are usual."""
    turn = Rotation.from_euler("z", angle_deg, degrees=True)
    readings_T = wu_run.recording.readings_T.copy()
    readings_T[:, 0] = turn.inv().apply(readings_T[:, 0])
    told = calibrate(replace(wu_run.recording, readings_T=readings_T), wu_scenario.array).warnings
    assert any(f"turned by {angle_deg:g}° against sensor 1" in one for one in told) is (angle_deg > 5)


@pytest.mark.parametrize(("bias_T", "doubted"), [(100e-6, False), (150e-6, True)])
def test_a_bias_of_more_than_twice_the_field_is_told(wu_run, wu_scenario, bias_T, doubted):
    """It is a magnet, or an offset of a driver."""
    readings_T = wu_run.recording.readings_T.copy()
    readings_T[:, 2, 1] += bias_T
    told = calibrate(replace(wu_run.recording, readings_T=readings_T), wu_scenario.array).warnings
    assert any("the bias of sensor 3 y is" in one for one in told) is doubted


@pytest.mark.parametrize(
    ("samples", "value", "warns"), [(1000, 0.24, True), (1000, 0.26, False), (80, 0.24, False), (9000, 1.0, False)]
)
def test_a_stated_noise_twice_too_large_is_told(wu_run, calibration, samples, value, warns):
    """It says what to do; where samples are few, six deviations of χ² are more than there can be."""
    told = replace(calibration, samples=samples, reduced_chi_square={"common_mode": value})
    found = [one for one in doubts_of(wu_run.recording, told) if "standard errors are" in one]
    assert bool(found) == warns and all("leave it out to have it estimated" in one for one in found)
