"""A calibration file keeps what came from a prior, for people and programs."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.correction.parts import Moved, Update
from tam_calibration.files.schema import check
from tam_calibration.files.yaml_document import parse_mapping
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.data_sheet import ChangeRates
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import from_degrees, from_nanotesla
from tam_calibration.recordings.array_yaml import ArrayFile, array_to_mapping
from tam_calibration.results.calibration_yaml import calibration_from_yaml, calibration_to_mapping, calibration_to_yaml


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return an updated calibration with a change of each kind."""
    generator = np.random.default_rng(4)
    share = generator.uniform(size=(4, 12))
    share[0, 9:] = np.nan
    moved = [
        Moved(kind, 2, 1e-3 * generator.normal(size=3), 1e-4 * generator.uniform(size=3), 0.8, (("bias", 3),), since_s)
        for kind, since_s in (("scale factor", None), ("bias", 12.5), ("misalignment", 1.7e9))
    ]
    biases = "biases", 0
    moved.append(Moved("bias", 1, np.full(3, 1e-8), np.full(3, 1e-9), 0.9, (("several errors", 4),), None, biases))
    update = Update(
        "pier.csv", ChangeRates(bias_per_day=1.1e-9), 86_400.5, -3.7, share * 1e-3, share, 31.7, 29, 0.33, tuple(moved)
    )
    update = replace(update, prior_standard_errors=np.nan_to_num(update.prior_standard_errors))
    return replace(maximum_likelihood(recording, cross), update=update, temperature_C=11.23456789)


def test_what_came_from_a_prior_is_written(calibration):
    """Exactly: rates, shares, standard errors, changes and times, in the units of their keys."""
    stored = parse_mapping(calibration_to_yaml(calibration))["update"]
    update = calibration.update
    for name in ("prior", "elapsed_s", "warming_K", "chi_square", "freedom", "probability"):
        assert stored[name] == getattr(update, name), name
    assert_array_equal(np.array(stored["data_share"], float), update.data_share)
    assert_array_equal(stored["prior_standard_errors_SI"], update.prior_standard_errors)
    assert from_nanotesla(stored["change_rates"]["bias_nT_per_day"]) == update.rates.bias_per_day
    scale, bias, turn, part = stored["moved"]
    assert_array_equal(scale["change"], update.moved[0].change)
    assert_array_equal(from_nanotesla(np.array(bias["change_nT"])), update.moved[1].change)
    assert_array_equal(from_nanotesla(np.array(bias["standard_error_nT"])), update.moved[1].standard_errors)
    assert_array_equal(from_degrees(np.array(turn["change_deg"])), update.moved[2].change)
    assert [each["since_s"] for each in stored["moved"]] == [None, 12.5, 1.7e9, None]
    assert [each["kind"] for each in stored["moved"]] == ["scale factor", "bias", "misalignment", "bias"]
    assert bias["sensor"] == 2 and bias["probability"] == 0.8 and bias["rivals"] == [{"kind": "bias", "sensor": 3}]
    assert part["together"] == {"kind": "biases", "sensor": 0} and bias["together"] is None


def test_a_calibration_is_read_without_what_came_from_a_prior(calibration):
    """It tells how the calibration was made; the temperature is read to the last bit."""
    read = calibration_from_yaml(calibration_to_yaml(calibration), "file")
    assert read.update is None and read.temperature_C == calibration.temperature_C
    plain = replace(calibration, update=None, temperature_C=None)
    assert "update" not in calibration_to_mapping(plain)
    assert calibration_from_yaml(calibration_to_yaml(plain), "file").temperature_C is None


def test_an_array_states_how_its_sensors_change(cross):
    """With units in the keys; what is left out is the default's; attitude's errors beside it."""
    stated = {"bias_nT_per_day": 2.0, "scale_factor_ppm_per_K": 7.0, "misalignment_deg_per_day": 0.01}
    file = check({"baseline_m": 0.5, "change_rates": stated, "attitude_noise_deg": 0.1}, ArrayFile)
    array = file.to_array()
    expected = ChangeRates(bias_per_day=2e-9, scale_factor_per_K=7e-6, misalignment_per_day=np.radians(0.01))
    assert array.change_rates == expected
    assert array.attitude_noise == pytest.approx(np.radians(0.1)) and array.mounting_error is None
    again = check(array_to_mapping(array), ArrayFile).to_array()
    assert again.change_rates == array.change_rates and again.attitude_noise == array.attitude_noise
    estimated = check({"baseline_m": 0.5, "attitude_noise_deg": "estimate"}, ArrayFile).to_array()
    assert estimated.attitude_noise == np.inf and array_to_mapping(estimated)["attitude_noise_deg"] == "estimate"
    with pytest.raises(InputError, match="attitude_noise_deg"):
        check({"baseline_m": 0.5, "attitude_noise_deg": "guess"}, ArrayFile)
    with pytest.raises(InputError, match="bias_per_day"):
        check({"baseline_m": 0.5, "change_rates": {"bias_nT_per_day": 1e9}}, ArrayFile).to_array()
