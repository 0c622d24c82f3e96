import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.normal_equations import gram


@pytest.mark.parametrize("shape", [(1, 5), (13, 1), (11, 20_000), (48, 1001)])
def test_it_is_the_sum_of_the_outer_products(shape):
    """Whatever the size, the sum is that of one product, and as symmetric."""
    columns = np.random.default_rng(2).normal(size=shape)
    found = gram(columns)
    assert_allclose(found, columns @ columns.T, rtol=1e-10, atol=1e-10)
    assert_allclose(found, found.T, rtol=1e-12, atol=1e-10)
