"""What the calibrator answers when something goes wrong, without any process."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.model.exceptions import InputError, Refused

pytest.importorskip("rclpy", reason="rclpy is not installed: pip install 'tam_calibration[ros]'")


@pytest.mark.parametrize(
    ("problem", "said"),
    [
        (InputError("too few\nsamples"), "too few samples"),
        (Refused("not one calibration"), "not one calibration"),
        (ZeroDivisionError("by zero"), "a defect of this software: ZeroDivisionError('by zero')"),
    ],
)
def test_no_problem_of_a_fit_ends_the_node(problem, said):
    """Bad data, a refusal and a defect are all answered with no and the reason on one line."""
    from tam_calibration.nodes.calibrator_node import Calibrator

    def fail():
        raise problem

    silent = SimpleNamespace(info=str, warning=str, error=str)
    answer = Calibrator._answering(SimpleNamespace(get_logger=lambda: silent), fail)
    response = answer(None, SimpleNamespace(success=True, message=""))
    assert response.success is False
    assert response.message == said


def rows_of(count):
    """Return stamps and rows of one sensor at 100 Hz."""
    stamps = [10**18 + index * 10**7 for index in range(count)]
    return [(stamp, np.array([stamp / 1e9, index, 1.0, 2.0])) for index, stamp in enumerate(stamps)]


def stored(rows, capacity=1000):
    """Return the recording of rows that were stored one by one."""
    from tam_calibration.nodes.calibrator_node import SampleStore

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
