from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit.published import simplified_linear
from tam_calibration.model.sensor_errors import SensorErrors


@pytest.mark.parametrize(("size", "bias_T", "scale"), [(1.0, 3.5e-9, 1.3e-3), (0.1, 3.5e-11, 1.3e-5)])
def test_what_it_leaves_is_of_second_order(noise_free, wu_scenario, size, bias_T, scale):
    """Errors a tenth as large leave a hundredth."""
    none = SensorErrors.none(4).to_vector()
    errors = SensorErrors.from_vector(none + size * (noise_free.errors.to_vector() - none))
    recording = replace(noise_free.recording, readings_T=errors.distort(noise_free.center_field_T))
    found = simplified_linear(recording, wu_scenario.array).errors
    assert np.abs(found.bias_T - errors.bias_T).max() == pytest.approx(bias_T, rel=0.3)
    assert np.abs(found.scale_factor - errors.scale_factor).max() == pytest.approx(scale, rel=0.3)
