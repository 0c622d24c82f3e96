"""Tolerances are standard deviations of a sensor's errors about none, of sizes that sensors have."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.exceptions import InputError

SHEET = {"scale_factor": 0.01, "non_orthogonality": 0.02, "bias_T": 3e-6, "misalignment": 0.03}


def test_variances_are_in_the_order_of_the_parameters():
    """Three of each kind: scale factors, non-orthogonality, bias, misalignment."""
    assert_allclose(np.sqrt(Tolerances(**SHEET).variances()), np.repeat([0.01, 0.02, 3e-6, 0.03], 3))


@pytest.mark.parametrize(("name", "largest"), [("scale_factor", 0.2), ("bias_T", 2e-3), ("misalignment", np.pi / 12)])
def test_what_no_sensor_keeps_to_is_refused(name, largest):
    """Zero, which would be known for certain; less; unknown; and more than a calibration may have that is accepted."""
    Tolerances(**{**SHEET, name: largest})
    for value in (0.0, -0.01, np.nan, 1.01 * largest):
        with pytest.raises(InputError, match=f"the tolerance of {name} is"):
            Tolerances(**{**SHEET, name: value})
