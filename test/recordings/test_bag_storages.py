"""A storage of bags is one module and one line in the registry."""

import sys
from types import ModuleType
from typing import ClassVar

import pytest
from numpy.testing import assert_array_equal

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import bag_sqlite3, read_recording
from tam_calibration.recordings.bag_storages import STORAGES, RegisteredStorage, is_bag, storage_of
from tam_calibration.results import write_recording


class Renamed:
    """Opens files of sqlite3 that are named otherwise, so that nothing else can have read or written them."""

    SUFFIX = ".drawer"


class File(Renamed, bag_sqlite3.Sqlite3File):
    """Of such files."""

    OPENED: ClassVar = []

    def __init__(self, path):
        super().__init__(path)
        self.OPENED.append(path)


class Writer(Renamed, bag_sqlite3.Sqlite3BlockWriter):
    """Of such files."""

    def __init__(self, path, compression):
        super().__init__(path, compression)
        self.path = self.path.rename(self.path.with_suffix(self.SUFFIX))


@pytest.fixture
def drawer(monkeypatch):
    """Register a made-up storage: its module, and its one line."""
    module = ModuleType("drawer_storage")
    module.FILE, module.WRITER = File, Writer
    module.condition_of, module.complete_messages = bag_sqlite3.condition_of, bag_sqlite3.complete_messages
    monkeypatch.setitem(sys.modules, module.__name__, module)
    storage = RegisteredStorage("drawer", Renamed.SUFFIX, b"SQLite format 3\0", module.__name__, stands_alone=True)
    monkeypatch.setitem(STORAGES, "drawer", storage)
    return module


def test_a_folder_is_written_and_read_by_the_registered_module(tmp_path, drawer, recording):
    """All else asks the registry."""
    path = tmp_path / "bag"
    write_recording(path, recording, storage="drawer")
    assert {file.name for file in path.iterdir()} == {"bag.drawer", "metadata.yaml"}
    assert "storage_identifier: drawer" in (path / "metadata.yaml").read_text()
    assert storage_of(path) == "drawer"
    read = read_recording(path)
    assert [path / "bag.drawer"] == File.OPENED
    assert_array_equal(read.readings_T, recording.readings_T)


def test_a_single_file_is_a_bag_of_its_own(tmp_path, drawer, recording):
    """Where the storage says that its files stand alone."""
    path = tmp_path / "run.drawer"
    write_recording(path, recording)
    assert path.is_file() and is_bag(path) and storage_of(path) == "drawer"
    assert_array_equal(read_recording(path).readings_T, recording.readings_T)


@pytest.mark.parametrize("name", ["sqlite3", "mcap"])
def test_the_storages_of_ros_are_told_by_their_folders(tmp_path, recording, name):
    """As the bag that is written beside a bag has its storage."""
    write_recording(tmp_path / "bag", recording, storage=name)
    assert storage_of(tmp_path / "bag") == name


def test_a_storage_that_is_not_registered_is_named(tmp_path, recording):
    """In one sentence with those that are; nothing is written."""
    with pytest.raises(InputError, match="storage 'drawer' is not known: choose one of sqlite3, mcap"):
        write_recording(tmp_path / "bag", recording, "drawer")
    assert not list(tmp_path.iterdir())
