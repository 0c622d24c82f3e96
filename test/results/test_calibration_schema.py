"""A calibration file keeps what came from a prior exactly, and files without it are read on."""

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.correction.parts import Moved, Update
from tam_calibration.files.schema import check
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.data_sheet import ChangeRates
from tam_calibration.model.exceptions import InputError
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


def test_what_is_written_is_read_back(calibration):
    """To the last bit: rates, shares, standard errors, changes, times."""
    read = calibration_from_yaml(calibration_to_yaml(calibration), "file")
    assert read.temperature_C == calibration.temperature_C
    for name in ("prior", "rates", "elapsed_s", "warming_K", "chi_square", "freedom", "probability"):
        assert getattr(read.update, name) == getattr(calibration.update, name), name
    assert_array_equal(read.update.data_share, calibration.update.data_share)
    assert_array_equal(read.update.prior_standard_errors, calibration.update.prior_standard_errors)
    for one, other in zip(read.update.moved, calibration.update.moved, strict=True):
        for field in fields(Moved):
            assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_files_without_it_are_read(calibration):
    """Those of before have neither."""
    plain = replace(calibration, update=None, temperature_C=None)
    assert "update" not in calibration_to_mapping(plain)
    read = calibration_from_yaml(calibration_to_yaml(plain), "file")
    assert read.update is None and read.temperature_C is None


def test_damage_is_told(calibration):
    """A table that lacks a sensor, a change without its size, and a kind that there is not."""
    content = calibration_to_mapping(calibration)
    for change, words in (
        (lambda update: update["data_share"].pop(), "data_share must have 4 rows of 12"),
        (lambda update: update["moved"][1].pop("change_nT"), "a bias that moved has no change_nT"),
        (lambda update: update["moved"][0].update(kind="colour"), "kind: input should be"),
    ):
        update = {**content["update"]}
        update["data_share"] = list(update["data_share"])
        update["moved"] = [dict(each) for each in update["moved"]]
        change(update)
        with pytest.raises(InputError, match=words):
            calibration_from_yaml(dump_mapping({**content, "update": update}), "file")


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
