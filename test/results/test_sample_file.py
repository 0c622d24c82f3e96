"""Samples on disk: what is read is what was saved, to the bit; what is of something else or damaged is set aside."""

import itertools
import sqlite3

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tam_calibration.messages.sample_store import StoredSample, Unsaved
from tam_calibration.model.exceptions import InputError
from tam_calibration.results import write_recording
from tam_calibration.results.sample_file import SampleFile


def samples(start, stop, stride=1):
    """Return samples with these numbers."""
    numbers = [number for number in range(start, stop) if number % stride == 0]
    return [StoredSample(n, 10**18 + n, 10**18 + 2 * n, np.array([1e9 + n, n / 3, np.nan])) for n in numbers]


def assert_same(found, expected):
    """Assert that samples are the same to the last bit."""
    assert [sample[:3] for sample in found] == [sample[:3] for sample in expected]
    for one, other in zip(found, expected, strict=True):
        assert_array_equal(one.row.view(np.uint64), other.row.view(np.uint64))


def test_what_was_saved_is_read_again(tmp_path):
    """Samples that are added, thinned out and forgotten, in a folder that was not there."""
    path = tmp_path / "new" / "samples"
    file = SampleFile(path, "array")
    assert file.read() == [] and file.set_aside is None
    file.save(Unsaved(True, 1, samples(0, 50)))
    file.save(Unsaved(False, 1, samples(50, 70)))
    assert_same(SampleFile(path, "array").read(), samples(0, 70))
    file.save(Unsaved(False, 4, samples(70, 90, 4)))
    assert_same(SampleFile(path, "array").read(), samples(0, 90, 4))
    again = SampleFile(path, "array")
    again.read()
    again.save(Unsaved(False, 8, samples(90, 100, 8)))
    assert_same(again.read(), samples(0, 100, 8))
    again.save(Unsaved(True, 1, samples(0, 3)))
    again.close()
    assert_same(SampleFile(path, "array").read(), samples(0, 3))


@given(cut=st.integers(0, 20_000), savings=st.lists(st.integers(1, 40), min_size=1, max_size=6))
def test_savings_are_whole_or_absent_where_the_writing_broke_off(tmp_path_factory, cut, savings):
    """Wherever the log of the last savings ends, what is read are the first so many of them."""
    path, copy = tmp_path_factory.mktemp("kept") / "samples", tmp_path_factory.mktemp("broken") / "samples"
    file, ends = SampleFile(path, "array"), np.cumsum([0, *savings]).tolist()
    for index, (start, stop) in enumerate(itertools.pairwise(ends)):
        file.save(Unsaved(index == 0, 1, samples(start, stop)))
    copy.write_bytes(path.read_bytes())
    log = path.with_name("samples-wal").read_bytes()
    copy.with_name("samples-wal").write_bytes(log[: len(log) - min(cut, len(log))])
    file.close()
    found = SampleFile(copy, "array").read()
    assert len(found) in ends
    assert_same(found, samples(0, len(found)))


@pytest.mark.parametrize("content", [b"no database" * 100, b"SQLite format 3\0" + bytes(5000)])
def test_a_damaged_file_is_set_aside(tmp_path, content):
    """It is renamed, not changed, and a new one is begun."""
    path = tmp_path / "samples"
    path.write_bytes(content)
    file = SampleFile(path, "array")
    assert file.set_aside == tmp_path / "samples.1" and file.set_aside.read_bytes() == content
    file.save(Unsaved(True, 1, samples(0, 5)))
    assert len(file.read()) == 5


def test_a_bag_is_set_aside_unchanged(tmp_path, recording):
    """A recorded file that is named by mistake keeps every byte."""
    write_recording(tmp_path / "run", recording)
    path = (tmp_path / "run/run.db3").rename(tmp_path / "samples")
    content = path.read_bytes()
    file = SampleFile(path, "array")
    file.save(Unsaved(True, 1, samples(0, 5)))
    assert file.set_aside is not None and file.set_aside.read_bytes() == content


def test_samples_of_another_array_are_set_aside(tmp_path):
    """Each under a name of its own, with all that was saved."""
    path = tmp_path / "samples"
    for number, about in enumerate(["one", "two", "three"]):
        file = SampleFile(path, about)
        file.save(Unsaved(True, 1, samples(0, 5 + number)))
    assert file.set_aside == tmp_path / "samples.2"
    assert_same(SampleFile(tmp_path / "samples.1", "one").read(), samples(0, 5))
    assert_same(SampleFile(tmp_path / "samples.2", "two").read(), samples(0, 6))


def test_what_cannot_be_written_is_refused_with_a_way_out(tmp_path):
    """A folder in its place, a file in place of its folder; and a write that fails leaves what was there."""
    (tmp_path / "file").touch()
    for path in (tmp_path, tmp_path / "file" / "samples"):
        with pytest.raises(InputError, match="name another samples_file, or none"):
            SampleFile(path, "array")
    file = SampleFile(tmp_path / "samples", "array")
    file.save(Unsaved(True, 1, samples(0, 5)))
    with pytest.raises(InputError, match="cannot be kept"):
        file.save(Unsaved(True, 1, [*samples(0, 2), *samples(1, 3)]))
    assert_same(file.read(), samples(0, 5))
    with sqlite3.connect(tmp_path / "samples") as other:
        assert other.execute("PRAGMA integrity_check").fetchone() == ("ok",)
