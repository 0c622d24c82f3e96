"""Missions of two platforms, and a way to do tasks in this process with a stand-in for the diagnosis."""

import shutil
from dataclasses import replace
from importlib import import_module

import pytest

from tam_calibration.fleet.task import read_options
from tam_calibration.model.array import Array
from tam_calibration.recordings import write_array
from tam_calibration.recordings.channel_map import Reading
from tam_calibration.results import write_recording

DAY_S = 86_400.0


@pytest.fixture(scope="session")
def cross(cross):
    """Return an array of two sensors, whose calibrations are written in a quarter of the time that four take."""
    return Array(cross.positions_m[:2], cross.vector_noise_T[:2], cross.scalar_noise_T)


@pytest.fixture(scope="session")
def recording(recording):
    """Return the recording of the two."""
    return replace(recording, readings_T=recording.readings_T[:, :2])


@pytest.fixture(scope="session")
def mission(recording):
    """Return a function that makes the recording of a day, whose biases have grown by 2 nT a day."""
    recording = recording.take(slice(0, 200))
    return lambda day: replace(
        recording, time_s=recording.time_s + DAY_S * day, readings_T=recording.readings_T + 2e-9 * day
    )


@pytest.fixture(scope="session")
def files(tmp_path_factory, mission, cross):
    """Return a folder with missions of every format, a file that is none among them, and the array file."""
    folder = tmp_path_factory.mktemp("fleet")
    for platform in ("auv_1", "auv_2"):
        (folder / "missions" / platform).mkdir(parents=True)
    write_recording(folder / "missions/auv_1/dive_0.csv", mission(0))
    write_recording(folder / "missions/auv_1/dive_1.mcap", mission(1))
    write_recording(folder / "missions/auv_2/dive_2", mission(2))
    write_recording(folder / "missions/auv_2/dive_3", mission(3), storage="mcap")
    (folder / "missions/auv_2/damaged.mcap").write_text("no bag")
    write_array(folder / "array.yaml", cross)
    return folder


@pytest.fixture
def folder(tmp_path, monkeypatch, files):
    """Give a working folder with copies of them."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    return tmp_path


@pytest.fixture
def options(folder):
    """Return what is asked for every recording."""
    return read_options(folder / "array.yaml", None, Reading(tolerance_s=1e-3))


@pytest.fixture
def asked(monkeypatch, gap):
    """Put a stand-in in the place of the diagnosis; return what it was asked, and what it shall answer."""
    asked = {"answer": gap, "recordings": []}

    def diagnose(recording, array):
        asked["recordings"].append(recording)
        if isinstance(asked["answer"], Exception):
            raise asked["answer"]
        return asked["answer"]

    monkeypatch.setattr(import_module("tam_calibration.fleet.task"), "diagnose", diagnose)
    return asked
