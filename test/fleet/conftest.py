"""Missions of two platforms, and a way to do tasks in this process with a stand-in for the diagnosis."""

from dataclasses import replace
from importlib import import_module

import pytest

from tam_calibration.fleet.task import read_options
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.recordings import write_array
from tam_calibration.recordings.reading import Reading
from tam_calibration.results import write_recording

DAY_S = 86_400.0


@pytest.fixture(scope="session")
def mission(recording, true_errors):
    """Return a function that makes the recording of a day, whose biases have grown by 2 nT a day."""
    recording = recording.take(slice(0, 200))

    def make(day):
        more = SensorErrors(
            true_errors.scale_factor,
            true_errors.non_orthogonality,
            true_errors.bias_T + 2e-9 * day,
            true_errors.misalignment,
        )
        added = more.bias_T - true_errors.bias_T
        return replace(recording, time_s=recording.time_s + DAY_S * day, readings_T=recording.readings_T + added)

    return make


@pytest.fixture
def folder(tmp_path, monkeypatch, mission, cross):
    """Give a working folder with missions of every format, a file that is none among them, and the array file."""
    monkeypatch.chdir(tmp_path)
    for platform in ("auv_1", "auv_2"):
        (tmp_path / "missions" / platform).mkdir(parents=True)
    write_recording(tmp_path / "missions/auv_1/dive_0.csv", mission(0))
    write_recording(tmp_path / "missions/auv_1/dive_1.mcap", mission(1))
    write_recording(tmp_path / "missions/auv_2/dive_2", mission(2))
    write_recording(tmp_path / "missions/auv_2/dive_3", mission(3), storage="mcap")
    (tmp_path / "missions/auv_2/damaged.mcap").write_text("no bag")
    write_array(tmp_path / "array.yaml", cross)
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
