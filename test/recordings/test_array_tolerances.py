"""An array file states tolerances with their units, and all of them."""

import pytest

from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import from_degrees, from_nanotesla
from tam_calibration.recordings import read_array
from tam_calibration.recordings.array_yaml import write_array

STATED = "{scale_factor_percent: 0.7, non_orthogonality_deg: 0.3, bias_nT: 12.3, misalignment_deg: 2.1}"


def written(path, tolerances):
    """Return an array file."""
    path.write_text(f"{{baseline_m: 0.5, tolerances: {tolerances}}}")
    return path


def test_they_are_read_in_si_and_written_as_they_were(tmp_path):
    """Per cent, degrees and nanotesla; to the last bit through a file."""
    array = read_array(written(tmp_path / "stated.yaml", STATED))
    assert array.tolerances == Tolerances(0.7 / 100, from_degrees(0.3), from_nanotesla(12.3), from_degrees(2.1))
    write_array(tmp_path / "again.yaml", array)
    assert read_array(tmp_path / "again.yaml").tolerances == array.tolerances


@pytest.mark.parametrize(
    ("tolerances", "words"),
    [
        ("5", "tolerances: input should be a mapping"),
        ("{scale_factor_percent: 1, non_orthogonality_deg: 1, bias_nT: 100}", "misalignment_deg' is missing"),
        (STATED.replace("0.7", "0"), "the tolerance of scale_factor is 0"),
        (STATED.replace("12.3", ".inf"), "bias"),
        (STATED.replace("0.7", "70"), "the tolerance of scale_factor is 0.7, and lies above 0 and within 0.2"),
        (STATED.replace("bias_nT", "bias_uT"), "bias_nT' is missing"),
    ],
)
def test_what_states_none_is_refused(tmp_path, tolerances, words):
    """One that is left out would be known, or be anything; zero, another unit, another key."""
    with pytest.raises(InputError, match=words):
        read_array(written(tmp_path / "bad.yaml", tolerances))
