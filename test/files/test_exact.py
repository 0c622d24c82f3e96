"""Numbers for files read back as they were."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.files.exact import degrees_to_write, nanotesla_to_write
from tam_calibration.units import from_degrees, from_nanotesla


@given(st.lists(st.decimals(-1_000_000, 1_000_000, places=4), min_size=1))
def test_decimals_in_nanotesla_come_back(decimals):
    """Decimals in nT that were read are written as the same decimals."""
    values = np.array([float(value) for value in decimals])
    assert from_nanotesla(nanotesla_to_write(from_nanotesla(values))).tolist() == from_nanotesla(values).tolist()


@given(st.lists(st.floats(-1, 1), min_size=1))
def test_any_value_comes_back_to_the_last_bits(values):
    """Where no decimal reads as the very number, the one written differs in the last bit."""
    assert_allclose(from_nanotesla(nanotesla_to_write(np.array(values))), values, rtol=3e-16, atol=1e-300)
    assert_allclose(from_degrees(degrees_to_write(np.array(values))), values, rtol=3e-16, atol=1e-300)
