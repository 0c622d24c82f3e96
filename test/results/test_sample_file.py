"""Samples on disk: what is read is what was saved, to the bit; what is damaged or of something else is set aside."""

import json
import os
import pathlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tam_calibration.messages.sample_store import StoredSample
from tam_calibration.model.exceptions import InputError
from tam_calibration.results import write_recording
from tam_calibration.results.sample_file import SampleFile

ABOUT = {"array": {"name": "cross"}}


def samples(start, stop, stride=1):
    """Return samples with these numbers."""
    numbers = [number for number in range(start, stop) if number % stride == 0]
    return [StoredSample(n, 10**18 + n, 10**18 + 2 * n, np.array([1e9 + n, n / 3, np.nan])) for n in numbers]


def file_at(path, node="0/calibrator", about=ABOUT):
    """Return a file of samples of three numbers."""
    return SampleFile(path, node, about, 3)


def assert_same(found, expected):
    """Assert that samples are the same to the last bit."""
    assert [sample[:3] for sample in found] == [sample[:3] for sample in expected]
    for one, other in zip(found, expected, strict=True):
        assert_array_equal(one.row.view(np.uint64), other.row.view(np.uint64))


def assert_read(path, expected):
    """Assert that a file is whole and holds some samples."""
    found, is_whole = file_at(path).read()
    assert is_whole
    assert_same(found, expected)


@pytest.fixture(scope="module")
def undelayed():
    """Have no test wait for the disk that looks at what is in the files alone."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda descriptor: None)
        yield


def test_what_was_saved_is_read_again(tmp_path):
    """Samples that are added, thinned out and forgotten, in a folder that was not there."""
    path = tmp_path / "new" / "samples"
    file = file_at(path)
    assert file.read() == ([], False) and not file.remark
    file.save(samples(0, 50), 0)
    file.save(samples(0, 70), 50)
    assert_read(path, samples(0, 70))
    file.save(samples(0, 90, 4), 0)
    again = file_at(path)
    assert_same(again.read()[0], samples(0, 90, 4))
    again.save(samples(0, 100, 4), len(samples(0, 90, 4)))
    assert_read(path, samples(0, 100, 4))
    again.save([], 0)
    assert_read(path, [])


@settings(max_examples=50)
@given(cut=st.integers(0, 900), savings=st.lists(st.integers(1, 12), min_size=1, max_size=5))
def test_samples_are_whole_or_absent_where_the_writing_broke_off(tmp_path_factory, undelayed, cut, savings):
    """Wherever the last saving ends, what is read are the first so many samples, and it can be gone on with."""
    path, ends = tmp_path_factory.mktemp("kept") / "samples", np.cumsum([0, *savings]).tolist()
    file = file_at(path)
    file.save([], 0)
    before = path.stat().st_size
    for end, kept in zip(ends[1:], ends, strict=False):
        file.save(samples(0, end), kept)
    content = path.read_bytes()
    path.write_bytes(content[: max(len(content) - cut, before)])
    again = file_at(path)
    found, is_whole = again.read()
    assert is_whole and len(found) == max(len(content) - cut - before, 0) // 52
    assert_same(found, samples(0, len(found)))
    again.save(samples(0, 80), len(found))
    assert_read(path, samples(0, 80))


def test_a_byte_that_is_damaged_costs_one_sample_at_most(tmp_path, undelayed):
    """Each byte in turn: the file is set aside unchanged, all other samples are used to the bit, and it is gone on."""
    path, expected = tmp_path / "samples", samples(0, 4)
    file_at(path).save(expected, 0)
    content = path.read_bytes()
    for place in range(len(content)):
        damaged = bytearray(content)
        damaged[place] ^= (0xFF, 0x01, 0x20)[place % 3]
        path.write_bytes(damaged)
        file = file_at(path)
        found, is_whole = file.read()
        aside = tmp_path / "samples.1"
        assert not is_whole and len(found) >= 3 and aside.read_bytes() == damaged
        assert file.remark == f"{path} is damaged: it is now {aside}, and {len(found)} samples of it are used"
        assert_same(found, [sample for sample in expected if sample.number in {each.number for each in found}])
        file.save(found, 0)
        file.save([*found, *samples(4, 6)], len(found))
        assert_read(path, [*found, *samples(4, 6)])
        aside.unlink()


def failing_at(count, monkeypatch):
    """Have the call of the system that writes, after so many, fail as on a disk that is full."""
    left = [count]

    def patch(module, name):
        real = getattr(module, name)

        def write(*arguments, **extra):
            left[0] -= 1
            if left[0] == -1:
                if name == "pwrite":  # some of it is written
                    real(arguments[0], arguments[1][:30], arguments[2])
                raise OSError(28, "No space left on device")
            return real(*arguments, **extra)

        monkeypatch.setattr(module, name, write)

    for module, name in WRITES:
        patch(module, name)


WRITES = [(os, "pwrite"), (os, "fsync"), (os, "replace"), (os, "rename"), (pathlib.Path, "write_bytes")]


@pytest.mark.parametrize("failing", range(24))
def test_a_write_that_fails_costs_nothing_once_the_next_one_does_not(tmp_path, monkeypatch, failing):
    """Each call of the system fails once, the disk being full: what was kept stays, and all is kept later."""
    path = tmp_path / "samples"
    failing_at(failing, monkeypatch)
    file, on_disk = file_at(path), []
    for wanted in (samples(0, 3), samples(0, 5), samples(0, 9, 2), samples(0, 14, 2), []):
        goes_on = [each.number for each in wanted[: len(on_disk)]] == [each.number for each in on_disk]
        for _ in range(2):
            try:
                file.save(wanted, len(on_disk) if goes_on else 0)
            except InputError as problem:
                assert "No space left on device" in str(problem)
                found = file_at(path).read()[0] if path.exists() else []
                assert_same(found[: len(on_disk)], on_disk)
            else:
                break
        on_disk = wanted
        assert_read(path, wanted)
    assert not list(tmp_path.glob("samples.*"))


@pytest.mark.parametrize("content", [b"no samples" * 100, b"SQLite format 3\0" + bytes(5000)])
def test_a_file_of_something_else_is_set_aside(tmp_path, content):
    """It is renamed, not changed, and a new one is begun."""
    path = tmp_path / "samples"
    path.write_bytes(content)
    file = file_at(path)
    assert file.read() == ([], False)
    aside = tmp_path / "samples.1"
    assert file.remark == f"{path} held no samples of this array: it is now {aside}" and aside.read_bytes() == content
    file.save(samples(0, 5), 0)
    assert_read(path, samples(0, 5))


def test_a_bag_is_set_aside_unchanged(tmp_path, recording):
    """A recorded file that is named by mistake keeps every byte."""
    write_recording(tmp_path / "run", recording)
    path = (tmp_path / "run/run.db3").rename(tmp_path / "samples")
    content = path.read_bytes()
    assert file_at(path).read() == ([], False)
    assert (tmp_path / "samples.1").read_bytes() == content


def test_samples_of_another_array_are_set_aside(tmp_path):
    """Each under a name of its own, with all that was saved."""
    path = tmp_path / "samples"
    for number, name in enumerate(["one", "two", "three"]):
        file = file_at(path, about={"array": name})
        assert file.read() == ([], False)
        file.save(samples(0, 5 + number), 0)
    assert_same(file_at(tmp_path / "samples.1", about={"array": "one"}).read()[0], samples(0, 5))
    assert_same(file_at(tmp_path / "samples.2", about={"array": "two"}).read()[0], samples(0, 6))


def test_each_node_has_a_file_of_its_own(tmp_path):
    """The second one leaves that of the first where it is, takes no sample of it, and finds its own again."""
    path = tmp_path / "samples"
    file_at(path, "0/a/calibrator").save(samples(0, 5), 0)
    for count in (0, 3):
        other = file_at(path, "0/b/calibrator")
        assert_same(other.read()[0], samples(0, count))
        assert other.path == tmp_path / "samples.0.b.calibrator"
        assert other.remark == f"{path} is of another node: this one has {other.path}"
        other.save(samples(0, 3), 0)
    assert_same(file_at(path, "0/a/calibrator").read()[0], samples(0, 5))


def test_a_row_of_another_file_is_not_taken(tmp_path):
    """The checksum of a row is over the first line too: where that is damaged no node takes the rows of another."""
    path = tmp_path / "samples"
    file_at(path, "0/a/calibrator").save(samples(0, 5), 0)
    path.write_bytes(path.read_bytes().replace(b"0/a/", b"0/b/", 1))
    assert file_at(path, "0/b/calibrator").read() == ([], False)


def test_a_file_that_was_taken_away_is_written_anew(tmp_path):
    """With all samples; one that another program put in its place is set aside."""
    path = tmp_path / "samples"
    file = file_at(path)
    file.save(samples(0, 5), 0)
    path.unlink()
    file.save(samples(0, 7), 5)
    assert_read(path, samples(0, 7))
    path.write_text("something else")
    file.save(samples(0, 9), 7)
    assert_read(path, samples(0, 9))
    assert (tmp_path / "samples.1").read_text() == "something else"


def test_what_cannot_be_written_is_refused_with_a_way_out(tmp_path):
    """A folder or a device in its place, a file in place of its folder."""
    (tmp_path / "file").touch()
    (tmp_path / "pipe").symlink_to("/dev/null")
    for path in (tmp_path, tmp_path / "file" / "samples", tmp_path / "pipe"):
        with pytest.raises(InputError, match="name another samples_file, or none"):
            file_at(path).save(samples(0, 5), 0)


def test_the_first_line_tells_what_a_file_is_of(tmp_path):
    """As JSON, for people and other programs."""
    file_at(tmp_path / "samples").save([], 0)
    text = (tmp_path / "samples").read_text()
    assert json.loads(text.partition("{")[1] + text.partition("{")[2]) == {"node": "0/calibrator", **ABOUT}
