"""What is written together appears together, whole and on the disk, and nothing is left beside it."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from stat import S_IMODE
from tempfile import mkdtemp

import pytest

from tam_calibration.files import text_files
from tam_calibration.files.text_files import UNFINISHED, hold, remove_left_over, replace_folder, unfinished, write_set
from tam_calibration.model.exceptions import InputError


def content(folder):
    """Return what lies in a folder: text of files, None for folders."""
    return {str(path.relative_to(folder)): path.read_text() if path.is_file() else None for path in folder.rglob("*")}


def write_both(folder, text="new"):
    """Write two files together."""
    with write_set([folder / "a", folder / "b"]) as places:
        for place in places:
            place.write_text(text)


def test_files_appear_together(tmp_path):
    """None before the block is over, then both, and nothing beside."""
    (tmp_path / "b").write_text("old")
    with write_set([tmp_path / "a", tmp_path / "b"]) as (a, b):
        a.write_text("new")
        b.write_text("new")
        assert not (tmp_path / "a").exists() and (tmp_path / "b").read_text() == "old"
    assert content(tmp_path) == {"a": "new", "b": "new"}


def test_one_that_cannot_be_written_keeps_all_from_being_written(tmp_path):
    """Its place is taken by a folder: told before the work begins."""
    (tmp_path / "b").mkdir()
    with pytest.raises(InputError, match="b is a folder that exists already"):
        write_both(tmp_path)
    assert content(tmp_path) == {"b": None}


@pytest.mark.parametrize("old", [{}, {"a": "old"}, {"a": "old", "b": "old"}])
def test_one_that_cannot_be_moved_keeps_all_as_they_were(tmp_path, old):
    """Its place is taken by a folder meanwhile: what was moved already comes back."""
    for name, text in old.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match="b cannot be written"), write_set([tmp_path / "a", tmp_path / "b"]) as (a, b):
        a.write_text("new")
        b.write_text("new")
        (tmp_path / "b").unlink(missing_ok=True)
        (tmp_path / "b").mkdir()
        (tmp_path / "b/kept").write_text("kept")
    assert content(tmp_path) == {name: text for name, text in old.items() if name == "a"} | {
        "b": None,
        "b/kept": "kept",
    }


def test_a_link_that_was_replaced_comes_back_as_a_link(tmp_path, monkeypatch):
    """Also where the disk has no hard links."""
    (tmp_path / "target").write_text("old")
    (tmp_path / "a").symlink_to("target")

    def refuse(*arguments, **options):
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr(os, "link", refuse)
    with pytest.raises(InputError), write_set([tmp_path / "a", tmp_path / "b"]) as (a, b):
        a.write_text("new")
        b.write_text("new")
        (tmp_path / "b").mkdir()
    assert os.readlink(tmp_path / "a") == "target" and (tmp_path / "target").read_text() == "old"


@pytest.mark.parametrize("mode", [0o600, 0o640, 0o444, 0o755])
def test_an_existing_file_keeps_its_mode(tmp_path, mode):
    """A file that only its owner may read stays so; a new file has the mode of the process."""
    (tmp_path / "a").write_text("old")
    (tmp_path / "a").chmod(mode)
    write_both(tmp_path)
    (tmp_path / "new").touch()
    modes = {name: S_IMODE((tmp_path / name).stat().st_mode) for name in ("a", "b", "new")}
    assert modes == {"a": mode, "b": modes["new"], "new": modes["new"]}


@pytest.mark.parametrize("mode", [0o700, 0o750])
def test_an_existing_folder_keeps_its_mode(tmp_path, mode):
    """Also when a newer folder takes its place."""
    (tmp_path / "result").mkdir(mode=mode)
    with unfinished(tmp_path / "result") as folder:
        (folder / "result").mkdir()
        replace_folder(folder / "result", tmp_path / "result")
    assert S_IMODE((tmp_path / "result").stat().st_mode) == mode


@pytest.mark.parametrize("target", ["target", "elsewhere/target", "other_link", "elsewhere/missing"])
def test_a_link_stays_and_its_target_is_written(tmp_path, target):
    """Also through two links, into another folder, and where the target is missing so far."""
    (tmp_path / "elsewhere").mkdir()
    for name in ("target", "elsewhere/target"):
        (tmp_path / name).write_text("old")
        (tmp_path / name).chmod(0o600)
    (tmp_path / "other_link").symlink_to("elsewhere/target")
    (tmp_path / "a").symlink_to(target)
    write_both(tmp_path)
    assert os.readlink(tmp_path / "a") == target
    written = (tmp_path / target).resolve()
    assert written.read_text() == "new"
    assert written.name == "missing" or S_IMODE(written.stat().st_mode) == 0o600
    assert not [name for name in content(tmp_path) if UNFINISHED in name]


def test_a_link_that_leads_in_a_circle_is_refused(tmp_path):
    """It leads to no file that could be written."""
    (tmp_path / "a").symlink_to("b")
    (tmp_path / "b").symlink_to("a")
    with pytest.raises(InputError, match="a is not a regular file"):
        write_both(tmp_path)
    assert os.readlink(tmp_path / "a") == "b"


def test_what_is_not_written_is_left_out(tmp_path):
    """An older file at its place stays; the others are there."""
    (tmp_path / "b").write_text("old")
    with write_set([tmp_path / "a", tmp_path / "b"]) as (a, _):
        a.write_text("new")
    assert content(tmp_path) == {"a": "new", "b": "old"}


def test_all_is_on_the_disk_before_it_is_moved_and_its_folder_after(tmp_path, monkeypatch):
    """A power cut leaves the old or the new file, never an empty one."""
    steps = []
    fsync, replace = os.fsync, os.replace

    def note_sync(descriptor):
        steps.append(os.readlink(f"/proc/self/fd/{descriptor}").rpartition("/")[2])
        fsync(descriptor)

    def note_move(place, path):
        steps.append("move")
        replace(place, path)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(os, "replace", note_move)
    with write_set([tmp_path / "bag", tmp_path / "file"]) as (bag, file):
        bag.mkdir()
        (bag / "data").write_text("new")
        file.write_text("new")
    assert steps == ["data", "bag", "file", "move", "move", tmp_path.name]


def test_a_disk_that_fails_at_the_end_is_told_and_all_is_as_it_was(tmp_path, monkeypatch):
    """What could not be kept is not shown as written."""
    (tmp_path / "a").write_text("old")

    def fail(descriptor):
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(InputError, match="cannot be written: Input/output error"):
        write_both(tmp_path)
    assert content(tmp_path) == {"a": "old"}


def test_a_sentence_names_the_path_and_not_the_place_beside_it(tmp_path):
    """What writes knows the place only."""
    with pytest.raises(InputError) as told, write_set([tmp_path / "a"]) as (place,):
        raise InputError(f"{place} cannot be written: full")
    assert str(told.value) == f"{tmp_path / 'a'} cannot be written: full"


_KILLED = """
import os, signal, sys
from pathlib import Path
from tam_calibration.files import text_files
from tam_calibration.files.text_files import write_set
with write_set([Path("a")]) as (place,):
    place.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_goes_with_the_next_writing(tmp_path):
    """Of the same path only, and nothing of a user's."""
    for name in (".a.hand", ".b.0123.unfinished"):
        (tmp_path / name).mkdir()
    done = subprocess.run([sys.executable, "-c", _KILLED], cwd=tmp_path)
    assert done.returncode == -signal.SIGKILL and len(list(tmp_path.glob(f".a.*{UNFINISHED}/a"))) == 1
    with pytest.raises(InputError), write_set([tmp_path / "a"]):
        raise InputError("the work failed")
    assert content(tmp_path) == {".a.hand": None, ".b.0123.unfinished": None}


def test_what_another_process_is_writing_stays(tmp_path):
    """Two may write to one path at once: the later one wins, and both are whole."""
    with write_set([tmp_path / "a"]) as (first,):
        first.write_text("first")
        with write_set([tmp_path / "a"]) as (second,):
            second.write_text("second")
        assert (tmp_path / "a").read_text() == "second"
    assert content(tmp_path) == {"a": "first"}


def test_a_folder_gives_way_to_a_newer_one_only(tmp_path):
    """The older one is there until the newer one is in place, and comes back where that never came."""
    (tmp_path / "result").mkdir()
    (tmp_path / "result/old").write_text("old")
    with unfinished(tmp_path / "result") as folder:
        (folder / "result").mkdir()
        (folder / "result/new").write_text("new")
        assert (tmp_path / "result/old").exists()
        replace_folder(folder / "result", tmp_path / "result")
    assert content(tmp_path) == {"result": None, "result/new": "new"}
    left = tmp_path / ".result.0123.unfinished"
    left.mkdir()
    (tmp_path / "result").rename(left / "result.older")  # killed between the two moves
    remove_left_over(left)
    assert content(tmp_path) == {"result": None, "result/new": "new"}


def test_an_older_folder_comes_back_where_the_newer_one_cannot_be_moved(tmp_path):
    """Nothing is lost by a disk that fails."""
    (tmp_path / "result").mkdir()
    with (
        pytest.raises(FileNotFoundError),
        unfinished(tmp_path / "result") as folder,
        pytest.MonkeyPatch.context() as patch,
    ):
        patch.setattr(text_files, "_sync", lambda path: None)
        replace_folder(folder / "missing", tmp_path / "result")
    assert content(tmp_path) == {"result": None}


def test_a_file_that_a_user_removed_does_not_come_back(tmp_path):
    """A file never leaves its place: what is kept of it is a second name."""
    left = tmp_path / ".a.0123.unfinished"
    left.mkdir()
    (left / "a.older").write_text("old")
    remove_left_over(left)
    assert content(tmp_path) == {}


def test_a_file_is_held_by_one(tmp_path):
    """Until it is let go; one that was replaced meanwhile is another."""
    path = tmp_path / "lock"
    path.touch()
    first = hold(path)
    with pytest.raises(BlockingIOError):
        hold(path)
    os.close(first)
    os.close(hold(path))
    path.unlink()
    with pytest.raises(FileNotFoundError):
        hold(path)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_while_all_is_moved_waits_until_that_is_done(tmp_path, monkeypatch, number):
    """It is not lost, and leaves nothing half."""
    seen = []
    before = signal.signal(number, lambda *_: seen.append(content(Path(tmp_path))))
    replace = os.replace

    def move_and_tell(place, path):
        replace(place, path)
        signal.raise_signal(number)

    monkeypatch.setattr(os, "replace", move_and_tell)
    try:
        write_both(tmp_path)
    finally:
        signal.signal(number, before)
    assert {"a": "new", "b": "new"}.items() <= seen[0].items()
    assert content(tmp_path) == {"a": "new", "b": "new"}


def test_a_signal_while_the_folder_is_made_leaves_none(tmp_path, monkeypatch):
    """Whoever was to remove it knows of it before the signal comes."""

    def make_and_tell(*words, **named):
        folder = mkdtemp(*words, **named)
        signal.raise_signal(signal.SIGTERM)
        return folder

    def end(number, frame):
        raise SystemExit(143)

    before = signal.signal(signal.SIGTERM, end)
    monkeypatch.setattr("tam_calibration.files.text_files.mkdtemp", make_and_tell)
    try:
        with pytest.raises(SystemExit):
            write_both(tmp_path)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert content(tmp_path) == {}


def test_an_error_of_the_system_while_writing_names_the_target(tmp_path):
    """A full disk says which file it was; another file's error stays as it is."""
    with pytest.raises(InputError, match=r"a cannot be written: full"), write_set([tmp_path / "a"]):
        raise OSError(28, "full")
    with pytest.raises(FileNotFoundError), write_set([tmp_path / "a"]):
        (tmp_path / "other").read_text()
