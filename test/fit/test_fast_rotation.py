from dataclasses import replace

import pytest

from tam_calibration.fit.published import fast_rotation
from tam_calibration.model.exceptions import InputError
from tam_validation.papers import li2018b


@pytest.mark.parametrize("noise_free", [True, False])
@pytest.mark.parametrize(("axes", "determined"), [("z", 32), ("x", 32), ("zx", 44), ("zxy", 45)])
def test_what_turns_determine(axes, determined, noise_free):
    """One turn determines 32 of 45 parameters, two 44, three all; noise is not taken for information."""
    case = li2018b.turns_about(axes)
    recording = case.recording
    if noise_free:
        recording = replace(recording, readings_T=case.errors.distort(case.field_T))
    assert li2018b.count_determined(recording, case.array) == (determined, 45)
    assert li2018b.count_determined(replace(recording, scalar_T=None), case.array) == (determined - 1, 44)


@pytest.mark.parametrize("axes", ["z", "zx"])
def test_turns_that_leave_parameters_open_are_refused_by_name(axes):
    """The ten samples of one turn of the paper are refused, and what they leave open is named."""
    case = li2018b.turns_about(axes)
    with pytest.raises(InputError, match=r"bias x.*of every sensor"):
        fast_rotation(case.recording, case.array)


def test_three_turns_calibrate():
    """Turns about three axes bring the tensor down to the noise."""
    case = li2018b.turns_about("zxy")
    calibration = fast_rotation(case.recording, case.array)
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.1 * calibration.floor.tensor_rmse_T_per_m


def test_directions_are_those_of_sensor_1():
    """Whatever another sensor reads: far off and at rest it hides none of the turns."""
    case = li2018b.turns_about("zxy")
    readings = case.recording.readings_T.copy()
    readings[:, 1:] = 1e-3
    found = li2018b.count_determined(replace(case.recording, readings_T=readings), case.array)
    assert found == li2018b.count_determined(case.recording, case.array)
