"""Sums over the samples around each one."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.neighbours import sum_around


@pytest.mark.parametrize("shape", [(30,), (30, 2), (30, 2, 3)])
def test_sums_are_those_of_the_samples_on_either_side(shape):
    """Fewer at the ends, and never the sample itself."""
    values = np.random.default_rng(1).normal(size=shape)
    expected = [values[max(n - 4, 0) : n + 5].sum(axis=0) - values[n] for n in range(30)]
    assert_allclose(sum_around(values, 4), expected, atol=1e-12)
