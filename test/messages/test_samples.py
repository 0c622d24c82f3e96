"""Stamps of samples as seconds."""

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from tam_calibration.messages.samples import seconds_of

NEAR_A_MIDDLE = [
    2**30 * 10**9 + round(odd * 10**9 / 2**23) + step for odd in (1, 12_345, 2**23 - 1) for step in (-1, 0, 1)
]
"""Stamps whose seconds lie as near as can be to the middle between two doubles."""


@given(st.lists(st.integers(0, 2**31 * 10**9 - 1), min_size=1))
@example(NEAR_A_MIDDLE)
@example([2**29 * 10**9, 2**29 * 10**9 + 1, 2**31 * 10**9 - 1])
def test_seconds_are_rounded_correctly(stamps_ns):
    """Each is the double nearest to the quotient, which is what Python's division of integers gives."""
    assert seconds_of(np.array(stamps_ns)).tolist() == [stamp / 10**9 for stamp in stamps_ns]


def test_no_stamps_are_no_seconds():
    """An empty batch stays empty."""
    assert seconds_of(np.zeros(0, dtype=np.int64)).shape == (0,)
