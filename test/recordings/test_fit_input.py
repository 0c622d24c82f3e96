"""The file of a known source."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.recordings.fit_input import read_known_source


@pytest.mark.parametrize("size", [5e-324, 1e-200, 1.0, 1e200, 1.7e308])
def test_an_axis_may_have_any_length(tmp_path, size):
    """Its direction alone counts, also where the square of its length is no number."""
    path = tmp_path / "source.yaml"
    axis = [size, 0.0, -size]
    path.write_text(f"{{recording: a.csv, position_m: [1, 2, 3], axis: {axis}, moment_Am2: 4, frequency_Hz: 10}}")
    moment = read_known_source(path).source.moment_Am2
    assert_allclose(moment, 4 * np.array([1, 0, -1]) / np.sqrt(2), rtol=1e-12)
