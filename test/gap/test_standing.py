"""How a form stands among its surrogates."""

import numpy as np
import pytest

from tam_calibration.gap.standing import Standing


def test_rank_and_ratio_are_among_all():
    """The form itself is one of those that explain as much."""
    standing = Standing.among(30.0, np.array([10.0, 31.0, 5.0]))
    assert (standing.largest, standing.rank) == (31.0, 0.5)
    assert standing.ratio == pytest.approx(30 / 31)


def test_without_surrogates_nothing_is_larger():
    """The ratio is then the gain, and the rank that of one."""
    standing = Standing.among(30.0, np.zeros(0))
    assert (standing.largest, standing.rank, standing.ratio) == (0.0, 1.0, 30.0)
