"""What tests of several commands need."""

import shutil

import pytest

from tam_calibration.fit import calibrate
from tam_calibration.recordings import write_array
from tam_calibration.results import write_calibration, write_recording


@pytest.fixture(scope="session")
def files(tmp_path_factory, recording, cross):
    """Return a folder with a recording as CSV and as bags of both kinds, its array file and its calibration."""
    folder = tmp_path_factory.mktemp("files")
    for name in ("run.csv", "run", "run.mcap"):
        write_recording(folder / name, recording)
    write_array(folder / "array.yaml", cross)
    write_calibration(folder / "c.yaml", calibrate(recording, cross))
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch, files):
    """Work in a folder with copies of the fixture `files`, which a module may replace; return it."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    return tmp_path
