"""First-order lags."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.effects.recursions import Memory, lagged, mode


def irregular(seed, count=300):
    """Return irregular times and a drive."""
    generator = np.random.default_rng(seed)
    return np.cumsum(generator.uniform(0.01, 1, count)), generator.normal(size=(count, 2))


@pytest.mark.parametrize("time_constant", [0.003, 0.3, 30.0])
def test_a_ramp_lags_by_the_time_constant(time_constant):
    """A drive that began long ago to rise steadily is followed a time constant behind, at irregular times too."""
    time, _ = irregular(1)
    late = lagged(time, time, time_constant)
    settled = 1 - np.exp(-(time - time[0]) / time_constant)
    assert_allclose(late, time - time_constant * settled, rtol=1e-9)


@pytest.mark.parametrize("time_constant", [-1.0, 0.0, 1e-320, 1e-200, 1e-9])
def test_a_time_constant_of_nothing_is_no_lag(time_constant):
    """Also where its inverse is no number."""
    time, drive = irregular(1)
    for late in (lagged(drive, time, time_constant), mode(drive, drive, time, time_constant)):
        assert_allclose(late, drive, rtol=0, atol=0)


@pytest.mark.parametrize("time_constant", [0.001, 0.1, 1.0])
def test_a_sinusoid_is_followed_with_its_gain_and_phase(time_constant):
    """A smooth drive with known rate comes out as the transfer function 1 / (1 + iωτ) says, below the step too."""
    time, rate = 0.1 * np.arange(800), 2.0
    drive = np.sin(rate * time)[:, None]
    late = mode(drive, rate * np.cos(rate * time)[:, None], time, time_constant)[:, 0]
    expected = np.imag(np.exp(1j * rate * time) / (1 + 1j * rate * time_constant))
    assert_allclose(late[300:], expected[300:], atol=2e-5)


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000), st.integers(0, 299), st.floats(1e-3, 1e3))
def test_no_sample_depends_on_later_ones(seed, changed, time_constant):
    """What comes after a sample does not change it."""
    time, drive = irregular(seed)
    other = drive.copy()
    other[changed] += 1
    equal = lagged(drive, time, time_constant)[:changed] == lagged(other, time, time_constant)[:changed]
    assert equal.all()


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 1000), st.lists(st.integers(1, 299), max_size=4), st.floats(1e-3, 1e3))
def test_batches_make_the_whole(seed, cuts, time_constant):
    """With its memory a lag goes on from batch to batch as if there were no cuts."""
    time, drive = irregular(seed)
    memory, parts = Memory(), []
    bounds = [0, *sorted(set(cuts)), len(time)]
    for start, stop in pairwise(bounds):
        memory.rewind()
        parts.append(lagged(drive[start:stop], time[start:stop], time_constant, memory))
    assert_allclose(np.concatenate(parts), lagged(drive, time, time_constant), atol=1e-12)
