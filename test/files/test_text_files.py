"""Text files appear complete or not at all."""

import os

import pytest

from tam_calibration.files.text_files import write_whole
from tam_calibration.model.exceptions import InputError


def test_a_file_appears_when_it_is_whole(tmp_path):
    """The target changes only after the block, and nothing else stays in the folder."""
    target = tmp_path / "a.txt"
    target.write_text("old")
    with write_whole(target) as beside:
        beside.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_failure_leaves_everything_as_it_was(tmp_path):
    """What was stored stays when writing fails half way."""
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), write_whole(target) as beside:
        beside.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]


def test_a_folder_is_never_replaced(tmp_path):
    """A folder that exists may hold anything: it is refused as a target."""
    with pytest.raises(InputError, match="is a folder that exists already"), write_whole(tmp_path):
        pass


@pytest.mark.parametrize("path", ["missing/a.txt", "a_file/a.txt"])
def test_a_target_that_cannot_be_written_is_named(tmp_path, path):
    """A folder that is missing or is a file is one sentence."""
    (tmp_path / "a_file").touch()
    with pytest.raises(InputError, match=r"a\.txt cannot be written: "), write_whole(tmp_path / path):
        pass


def test_devices_are_refused():
    """Renaming onto a device would destroy it."""
    with pytest.raises(InputError, match="not a regular file"), write_whole("/dev/null"):
        pass


def test_an_error_of_the_system_while_writing_names_the_target(tmp_path):
    """A full disk says which file it was; another file's error stays as it is."""
    with pytest.raises(InputError, match=r"a\.txt cannot be written: full"), write_whole(tmp_path / "a.txt"):
        raise OSError(28, "full")
    with pytest.raises(FileNotFoundError), write_whole(tmp_path / "a.txt"):
        (tmp_path / "other").read_text()
