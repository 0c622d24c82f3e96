"""The store of samples: bounded, in the time of one run, and the same after it was saved and resumed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.sample_store import LONGEST_PAUSE_NS, SampleStore, StoredSample


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


class Disk:
    """What a file holds of a store, in memory."""

    def __init__(self):
        self.samples: list[StoredSample] = []

    def save(self, changed):
        """Do as a file does."""
        before = [] if changed.begins else [each for each in self.samples if each.number % changed.stride == 0]
        self.samples = [*before, *changed.samples]


def resumed(before, after, capacity, savings):
    """Return a store that another process resumed after some samples; it was saved after these numbers of them."""
    first, second, disk = SampleStore(SampleLayout(1), capacity), SampleStore(SampleLayout(1), capacity), Disk()
    for index, row in enumerate(before):
        first.add(*row)
        if index in savings:
            disk.save(first.unsaved())
    disk.save(first.unsaved())
    second.resume(disk.samples)
    for row in after:
        second.add(*row)
    return second


BREAK = st.integers(4, 300)
SAVINGS = st.sets(st.integers(0, 300), max_size=4)


@given(BREAK, st.integers(2, 300), SAVINGS, st.integers(-400, 200))
def test_a_store_that_is_resumed_holds_what_one_without_a_break_holds(count, after, savings, step_ms):
    """Whenever it is saved, and wherever stamps stepped before, to the last bit."""
    rows = [
        (stamp + step_ms * 10**6 * (index >= count // 2), row)
        for index, (stamp, row) in enumerate(rows_of(count + after))
    ]
    held = resumed(rows[:count], rows[count:], 1000, savings).recording()
    assert_array_equal(held.time_s, stored(rows).time_s)
    assert_array_equal(held.readings_T, stored(rows).readings_T)


@given(BREAK, st.integers(2, 300), SAVINGS, st.integers(8, 200))
def test_a_full_store_that_is_resumed_stays_bounded(count, after, savings, capacity):
    """What was stored before the break is what would have been; then it goes on no sparser."""
    rows = rows_of(count + after)
    held = resumed(rows[:count], [], capacity, savings).recording()
    assert_array_equal(held.time_s, stored(rows[:count], capacity).time_s)
    gone_on = resumed(rows[:count], rows[count:], capacity, savings)
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
    assert len(resumed(rows, [], 1000, ())) == 100
    assert len(resumed(rows, later, 1000, ())) == kept
