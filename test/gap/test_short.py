"""Recordings that are too still for any verdict."""

import numpy as np
import pytest

from tam_calibration.gap.short import is_at_rest
from tam_calibration.recording import Recording


@pytest.mark.parametrize(("spread_T", "is_still"), [(0.2e-6, True), (0.42e-6, False)])
def test_a_sensor_that_moves_on_a_line_is_at_rest(spread_T, is_still):
    """Across it the readings spread by a third of a microtesla at least where it turns about a second axis."""
    readings = np.random.default_rng(1).normal(size=(400, 1, 3))
    readings *= [10e-6, spread_T, 1e-9] / readings.std(axis=0)
    assert is_at_rest(Recording(0.1 * np.arange(400), readings)) == is_still
