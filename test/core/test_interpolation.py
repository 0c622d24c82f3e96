"""The cubic through messages before and after a stamp: exact where it must be, and as wrong as is said."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.interpolate import BarycentricInterpolator

from tam_calibration.core.interpolation import LARGEST_ERROR, MOST_UNEVEN, is_even, weights

intervals = st.floats(0.1, 0.7)


@given(st.tuples(intervals, intervals, intervals), st.floats(0, 0.99))
def test_the_weights_are_those_of_the_cubic(each, part):
    """Scipy's interpolator through the same uneven stamps gives the same weights; a cubic is met exactly."""
    stamps = np.cumsum([0, *each])
    at = stamps[2] + part * each[2]
    ours = weights(*(stamps - at))
    assert_allclose(ours, [BarycentricInterpolator(stamps, unit)(at) for unit in np.eye(4)], atol=1e-12)
    assert_allclose(ours @ (stamps**3 - stamps), at**3 - at, atol=1e-12)


@given(st.lists(st.tuples(intervals, intervals, intervals, intervals), min_size=1, max_size=5))
def test_numbers_and_arrays_give_the_same_bits(rows):
    """Live messages come one by one, those of a recording as arrays: the values are the same to the last bit."""
    stamps = np.array([(-a - b - c, -b - c, -c, d) for a, b, c, d in rows])
    assert_allclose(np.transpose(weights(*stamps.T)), [weights(*row.tolist()) for row in stamps], rtol=0, atol=0)


def test_the_error_and_the_noise_are_those_that_are_said():
    """A field that turns at 180°/s, read at 50 Hz: 0.042 (ωh)⁴ of it at most; the noise grows by a tenth at most."""
    step = np.pi * 0.02
    at = np.linspace(0, 1, 101)[:-1, None]
    stamps = np.arange(-2.0, 2.0) - at
    weight = np.transpose(weights(*stamps.T))
    error = np.abs((weight * np.exp(1j * step * stamps)).sum(axis=1) - 1)
    assert 0.95 * LARGEST_ERROR * step**4 < error.max() < LARGEST_ERROR * step**4
    assert 50e3 * error.max() < 0.033
    growth = np.sqrt(np.sum(weight**2, axis=1))
    assert growth.min() > 0.86 and growth.max() < 1.09
    assert abs(np.mean(growth**2) - 1) < 0.01


@given(st.tuples(intervals, intervals, intervals), st.floats(1.01, 20), st.integers(0, 2))
def test_messages_that_lie_too_unevenly_make_no_value(each, longer, which):
    """From a ratio of intervals of ``MOST_UNEVEN`` on, in whichever interval messages were lost."""
    each = list(each)
    each[which] = min(each[:which] + each[which + 1 :]) * MOST_UNEVEN * longer
    assert not is_even(-each[1] - each[0], -each[1], 0.0, each[2])
    assert is_even(-2.0, -1.0, -0.5, MOST_UNEVEN * 0.5 - 0.5)
