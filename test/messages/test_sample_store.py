"""The store of samples: bounded, in the time of one run, and the same after it was saved and resumed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.sample_store import LONGEST_PAUSE_NS, SampleStore


def rows_of(count):
    """Return stamps and rows of one sensor at 100 Hz."""
    stamps = [10**18 + index * 10**7 for index in range(count)]
    return [(stamp, np.array([stamp / 1e9, index, 1.0, 2.0])) for index, stamp in enumerate(stamps)]


def stored(rows, capacity=1000):
    """Return the recording of rows that were stored one by one."""
    store = SampleStore(SampleLayout(1), capacity)
    for row in rows:
        store.add(*row)
    return store.recording()


def test_a_step_keeps_what_is_stored():
    """Time goes on by one interval where the stamps step back, also when half the samples were given up."""
    rows = rows_of(100)
    moved = [(stamp - 300_000_000, row - [0.3, 0, 0, 0]) for stamp, row in rows[50:]]
    recording = stored(rows[:50] + moved)
    assert_array_equal(recording.readings_T[:, 0, 0], np.arange(100))
    assert_array_equal(recording.time_s, [row[0] for _, row in rows])
    thinned = stored(rows[:50] + moved, capacity=64)
    assert_array_equal(thinned.time_s, recording.time_s[::2])


@pytest.mark.parametrize("error_ns", [-(10**18), -(10**9), 10**9, 3 * 10**16])
def test_a_foreign_sample_is_not_stored(error_ns):
    """One sample whose stamp no other follows is left out."""
    rows = rows_of(100)
    foreign = (rows[40][0] + error_ns, np.full(4, 7.0))
    assert_array_equal(stored([*rows[:40], foreign, *rows[40:]]).readings_T[:, 0, 0], np.arange(100))


def test_a_recording_that_is_played_again_starts_over():
    """The store then holds the new round only."""
    rows = rows_of(100)
    assert_array_equal(stored(rows + rows[:30]).readings_T[:, 0, 0], np.arange(30))


def resumed(before, after, capacity):
    """Return a store that another process resumed after some samples."""
    first, second = SampleStore(SampleLayout(1), capacity), SampleStore(SampleLayout(1), capacity)
    for row in before:
        first.add(*row)
    second.resume(first.samples()[1])
    for row in after:
        second.add(*row)
    return second


BREAK = st.integers(4, 300)


@given(BREAK, st.integers(2, 300), st.integers(-400, 200))
def test_a_store_that_is_resumed_holds_what_one_without_a_break_holds(count, after, step_ms):
    """Wherever stamps stepped before, to the last bit."""
    rows = [
        (stamp + step_ms * 10**6 * (index >= count // 2), row)
        for index, (stamp, row) in enumerate(rows_of(count + after))
    ]
    held = resumed(rows[:count], rows[count:], 1000).recording()
    assert_array_equal(held.time_s, stored(rows).time_s)
    assert_array_equal(held.readings_T, stored(rows).readings_T)


@given(BREAK, st.integers(2, 300), st.integers(8, 200))
def test_a_full_store_that_is_resumed_stays_bounded(count, after, capacity):
    """What was stored before the break is what would have been; then it goes on no sparser."""
    rows = rows_of(count + after)
    held = resumed(rows[:count], [], capacity).recording()
    assert_array_equal(held.time_s, stored(rows[:count], capacity).time_s)
    gone_on = resumed(rows[:count], rows[count:], capacity)
    assert len(gone_on) < capacity
    numbers = gone_on.recording().readings_T[:, 0, 0]
    assert numbers[0] == 0 and (np.diff(numbers) > 0).all() and np.diff(numbers).max() <= np.diff(numbers)[0]


@pytest.mark.parametrize(
    ("pause_ns", "kept"),
    [(10**7, 150), (LONGEST_PAUSE_NS, 150), (LONGEST_PAUSE_NS + 1, 50), (0, 50), (-(10**9), 50), (-(10**17), 50)],
)
def test_samples_that_do_not_follow_are_another_run(pause_ns, kept):
    """What a process before left is forgotten when samples come from before it, or long after."""
    rows = rows_of(100)
    later = [(stamp + 49 * 10**7 + pause_ns, row + 1e-9) for stamp, row in rows[50:]]
    assert len(resumed(rows, [], 1000)) == 100
    assert len(resumed(rows, later, 1000)) == kept


def test_the_generation_tells_whether_samples_were_only_added():
    """It grows when samples are given up or forgotten, so that what is on disk is to be written anew."""
    store, rows = SampleStore(SampleLayout(1), 64), rows_of(100)
    generations = []
    for row in rows:
        store.add(*row)
        generation, samples = store.samples()
        generations.append((generation, len(samples)))
    first = generations[0][0]
    assert [generation for generation, _ in generations[:63]] == [first] * 63
    assert generations[-1][0] == first + 1
    store.start_over()
    assert store.samples() == (first + 2, [])


@pytest.mark.parametrize("stride", [1, 2, 8])
@pytest.mark.parametrize("lost", [[0], [1], [0, 1, 2], [48], list(range(1, 49))])
def test_a_store_resumes_what_is_left_of_damaged_samples(stride, lost):
    """Those that are missing cost no other: the stride is that of the run, or a finer one, and time goes on."""
    rows = rows_of(500)
    first, second = SampleStore(SampleLayout(1), 1000), SampleStore(SampleLayout(1), 1000)
    for row in rows[: 49 * stride]:
        first.add(*row)
    kept = [each for each in first.samples()[1] if each.number % stride == 0]
    kept = [each for place, each in enumerate(kept) if place not in lost]
    second.resume(kept)
    for row in rows[49 * stride :]:
        second.add(*row)
    time_s = second.recording().time_s
    assert (np.diff(time_s) > 0).all() and time_s[-1] > rows[490][0] / 1e9
    assert set(kept[0].row) <= set(second.samples()[1][0].row)
