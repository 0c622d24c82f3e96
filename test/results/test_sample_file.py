"""Samples in memory, bounded, in the time of one run; and on disk: what is read is what was saved, to the bit."""

import json
import os
import pathlib

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.model.exceptions import InputError
from tam_calibration.results import write_recording
from tam_calibration.results.sample_file import LONGEST_PAUSE_NS, SampleFile, SampleStore, StoredSample


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


@example(9, 47, 8)
@given(BREAK, st.integers(2, 300), st.integers(8, 200))
def test_a_full_store_that_is_resumed_stays_bounded(count, after, capacity):
    """What was stored before the break is what would have been; then it goes on no sparser."""
    rows = rows_of(count + after)
    held = resumed(rows[:count], [], capacity).recording()
    assert_array_equal(held.time_s, stored(rows[:count], capacity).time_s)
    gone_on = resumed(rows[:count], rows[count:], capacity)
    assert len(gone_on) < capacity
    numbers = gone_on.recording().readings_T[:, 0, 0]
    apart = np.diff(numbers)
    _, samples = gone_on.samples()
    (stride,) = set(np.diff([one.number for one in samples]).tolist())
    assert numbers[0] == 0 and (apart > 0).all() and apart.max() <= stride


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
