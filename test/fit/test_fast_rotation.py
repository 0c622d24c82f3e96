from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.errors import SensorErrors
from tam_calibration.fit.fast_rotation import align, count_determined, fast_rotation
from tam_calibration.problems import InputError
from tam_calibration.reproduce import li2018b


@pytest.mark.parametrize("noise_free", [True, False])
@pytest.mark.parametrize(("axes", "determined"), [("z", 32), ("x", 32), ("zx", 44), ("zxy", 45)])
def test_what_turns_determine(axes, determined, noise_free):
    """One turn determines 32 of 45 parameters, two 44, three all; noise is not taken for information."""
    case = li2018b.turns_about(axes)
    recording = case.recording
    if noise_free:
        recording = replace(recording, readings_T=case.errors.distort(case.field_T))
    assert count_determined(recording, case.array) == (determined, 45)
    assert count_determined(replace(recording, scalar_T=None), case.array) == (determined - 1, 44)


@pytest.mark.parametrize(("axes", "determined"), [("z", 32), ("zx", 44)])
def test_turns_that_leave_parameters_open_are_refused_by_name(axes, determined):
    """The ten samples of one turn of the paper are refused, and what they leave open is named."""
    case = li2018b.turns_about(axes)
    with pytest.raises(InputError, match=f"the turns determine {determined} of 45 parameters.*bias x.*of every sensor"):
        fast_rotation(case.recording, case.array)


def test_three_turns_calibrate():
    """Turns about three axes bring the tensor down to the noise."""
    case = li2018b.turns_about("zxy")
    calibration = fast_rotation(case.recording, case.array)
    assert calibration.in_sample.tensor_rmse_T_per_m < 1.1 * calibration.floor.tensor_rmse_T_per_m


def test_three_samples_align_sensors_that_are_orthogonal():
    """Without noise three samples of one turn about any axis give the rotations between sensors exactly."""
    case = li2018b.turns_about("z")
    rotation = case.errors.rotation @ case.errors.rotation[0].T
    orthogonal = SensorErrors.from_matrix(rotation, np.zeros((4, 3)))
    recording = replace(case.recording, readings_T=orthogonal.distort(case.field_T)).take(slice(None, None, 12))
    assert recording.sample_count == 3
    found = align(recording, SensorErrors.none(4))
    assert_allclose(found.to_vector(), orthogonal.to_vector(), rtol=0, atol=1e-12)


def test_alignment_keeps_what_is_known_of_each_sensor():
    """Scale factors, non-orthogonality and bias come out as they went in."""
    case = li2018b.turns_about("z")
    recording = replace(case.recording, readings_T=case.errors.distort(case.field_T))
    found = align(recording, case.errors)
    assert_allclose(found.to_vector()[:, :9], case.errors.to_vector()[:, :9], rtol=0, atol=1e-12)
    assert_allclose(found.rotation, case.errors.rotation @ case.errors.rotation[0].T, atol=1e-12)


def test_alignment_says_what_it_needs():
    """Two samples, and samples that were not turned, are refused."""
    case = li2018b.turns_about("z")
    with pytest.raises(InputError, match="2 samples cannot align"):
        align(case.recording.take(slice(0, 2)), case.errors)
    still = replace(case.recording, readings_T=np.repeat(case.recording.readings_T[:1], 108 // 3, axis=0))
    with pytest.raises(InputError, match="along one line"):
        align(still, case.errors)
