"""Slow cosines of time."""

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.core.noise import BLOCKS, COSINES, slow_cosines


def test_they_are_orthogonal_to_each_other_and_to_the_mean():
    """So that their sums are independent for white samples, and have the variance of the plain sum."""
    cosines = np.column_stack([np.ones(BLOCKS), slow_cosines()])
    assert_allclose(cosines.T @ cosines, BLOCKS * np.eye(COSINES + 1), atol=1e-12 * BLOCKS)


def test_the_fastest_has_eight_blocks_in_a_period():
    """A constant that changes is met: four half cosines over sixteen blocks, the last with four changes of sign."""
    assert slow_cosines().shape == (16, 4)
    assert [int(np.sum(np.diff(np.sign(one)) != 0)) for one in slow_cosines().T] == [1, 2, 3, 4]
