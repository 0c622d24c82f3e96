"""Values between the readings: exact for cubics, as wrong as is said, and with the noise of a reading."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.core.interpolation import (
    BEFORE,
    LARGEST_ERROR,
    MOST_UNEVEN,
    interpolated,
    is_even,
    weights,
    without_delays,
)
from tam_calibration.model.recording import Recording

intervals = st.floats(0.1, 0.7)
four_intervals = st.tuples(intervals, intervals, intervals, intervals)


def even_weights(count):
    """Return times (count, 5) of even readings about as many places between two of them, and the weights there."""
    times = np.arange(-BEFORE + 1.0, 2.0) - np.linspace(0, 1, count, endpoint=False)[:, None]
    return times, np.transpose(weights(*times.T))


@given(four_intervals, st.floats(0, 0.99))
def test_a_cubic_is_met_and_the_noise_is_kept(each, part):
    """Numpy's solution of the same conditions with the least noise has that of a reading at most, or it is ours."""
    times = np.cumsum([0, *each])
    times -= times[3] + part * each[3]
    ours = np.array(weights(*times))
    conditions = np.vander(times, 4, increasing=True).T
    assert_allclose(conditions @ ours, [1, 0, 0, 0], atol=1e-9)
    least = np.linalg.lstsq(conditions, [1, 0, 0, 0], rcond=None)[0]
    assert_allclose(ours @ ours, max(least @ least, 1), rtol=1e-9)


@given(st.lists(st.tuples(intervals, four_intervals), min_size=1, max_size=5))
def test_numbers_and_arrays_give_the_same_bits(rows):
    """Live messages come one by one, those of a recording as arrays: the values are the same to the last bit."""
    times = np.array([(-a - b - c - d, -b - c - d, -c - d, -d, after) for after, (a, b, c, d) in rows])
    assert_allclose(np.transpose(weights(*times.T)), [weights(*row.tolist()) for row in times], rtol=0, atol=0)
    assert is_even(*times.T).tolist() == [is_even(*row.tolist()) for row in times]


def test_at_a_reading_it_is_that_reading():
    """To the last bit, in any unit."""
    for unit in (1.0, 1e7):
        assert weights(-3 * unit, -2 * unit, -unit, 0.0, unit) == (0, 0, 0, 1, 0)


def test_the_error_is_the_one_that_is_said():
    """A field that turns at 180°/s, read at 50 Hz: 0.049 (ωh)⁴ of it at most, 0.04 nT of the Earth's."""
    step = np.pi * 0.02
    times, weight = even_weights(100)
    error = np.abs((weight * np.exp(1j * step * times)).sum(axis=1) - 1)
    assert 0.95 * LARGEST_ERROR * step**4 < error.max() < LARGEST_ERROR * step**4
    assert 50e3 * error.max() < 0.04


def test_values_of_even_readings_are_as_noisy_as_these_and_nearly_as_independent():
    """Variances are one; correlations, less than 0.22, sum up to none, so that means are as noisy as of readings."""
    _, weight = even_weights(100)
    covariances = np.array([np.sum(weight[:, apart:] * weight[:, : 5 - apart], axis=1) for apart in range(5)])
    assert_allclose(covariances[0], 1, rtol=1e-12)
    assert 0.2 < np.abs(covariances[1:]).max() < 0.22
    assert_allclose(covariances[1:].sum(axis=0), 0, atol=1e-12)


@given(four_intervals, st.floats(1.01, 20), st.integers(0, 3))
def test_messages_that_lie_too_unevenly_make_no_value(each, longer, which):
    """From a ratio of intervals of ``MOST_UNEVEN`` on, in whichever interval messages were lost."""
    each = list(each)
    each[which] = min(each[:which] + each[which + 1 :]) * MOST_UNEVEN * longer
    assert not is_even(*(np.cumsum([0.0, *each]) - sum(each[:3])).tolist())
    assert is_even(-3.0, -2.0, -1.0, -0.5, MOST_UNEVEN * 0.5 - 0.5)


def test_a_scalar_that_is_stamped_late_moves_to_the_samples_it_was_read_at():
    """Its readings join the nearest sample, as those of messages do; before the first there is none."""
    time_s = 0.01 * np.arange(30)
    scalar_T = np.where(np.arange(30) % 10 == 0, 50e-6 + 1e-9 * np.arange(30), np.nan)
    late = Recording(time_s, np.full((30, 1, 3), 3e-5), scalar_T)
    mended = without_delays(late, np.array([0, 0.032])).scalar_T
    assert np.flatnonzero(np.isfinite(mended)).tolist() == [7, 17]
    assert_allclose(mended[[7, 17]], scalar_T[[10, 20]], rtol=0)


def test_a_scalar_joins_a_sample_within_half_a_step_only():
    """A reading of 12 ms after its stamp, where the next sample comes a second later, has none."""
    time_s = np.concatenate([0.01 * np.arange(10), 1 + 0.01 * np.arange(10)])
    scalar_T = np.full(20, np.nan)
    scalar_T[[4, 9, 14]] = 50e-6, 51e-6, 52e-6
    early = Recording(time_s, np.full((20, 1, 3), 3e-5), scalar_T)
    mended = without_delays(early, np.array([0, -0.012])).scalar_T
    assert np.flatnonzero(np.isfinite(mended)).tolist() == [5, 15]
    assert mended[[5, 15]].tolist() == [50e-6, 52e-6]


def test_values_between_are_told_where_enough_readings_are_around():
    """Four before and one after: a cubic is met to rounding; elsewhere nothing is told."""
    times = np.arange(0, 200, 10)
    course = np.array([[1.0, -2.0], [0.03, 0.01], [2e-4, -5e-4], [1e-6, 3e-6]])
    values = np.vander(times, 4, increasing=True) @ course
    asked = np.array([-5, 0, 25, 31, 47, 50, 189, 190, 195])
    told, after, weight = interpolated(times, values, asked)
    assert after.tolist() == [20, 20, 20, 4, 5, 6, 19, 20, 20]
    inside = after < 20
    assert_allclose(told[inside], np.vander(asked[inside], 4, increasing=True) @ course, rtol=1e-9)
    assert np.isnan(told[~inside]).all()
    assert_allclose(weight.sum(axis=1), np.ones(4))


def test_a_sensor_that_is_stamped_late_moves_to_the_samples_it_was_read_at():
    """A sine that a sensor has read 4 ms before its stamps is that of the others, wherever time begins."""
    time_s = 1.7e9 + 0.01 * np.arange(60)
    phase = 2 * np.pi * 0.5 * (time_s - time_s[0])
    early = 2 * np.pi * 0.5 * (time_s - time_s[0] - 0.004)
    readings_T = 5e-5 * np.stack([np.stack([np.sin(each), np.cos(each), 0 * each], 1) for each in (phase, early)], 1)
    mended = without_delays(Recording(time_s, readings_T), np.array([0, 0.004]))
    assert len(mended.time_s) >= 54
    assert_allclose(mended.readings_T[:, 1], mended.readings_T[:, 0], atol=1e-10)
