"""Rows as samples: each holds the readings of one moment, and what is missing in them is told."""

import logging

import numpy as np
import pytest
from inspected import columns_of, times, turned, write_text
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.messages.samples import NO_USAGE
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.recordings import read_recording, text_source
from tam_calibration.recordings.channel_map import Reading, Window
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.recordings.recording_file import read_pieces, read_samples

TIME = times(first_ns=0) / 1e9


def table(path, sensors=2, count=400, **more):
    """Write a text of some sensors in nT; more columns replace or add some."""
    columns = {"time_s": TIME[:count]}
    for sensor in range(sensors):
        columns |= columns_of(f"mag{sensor}_", turned(48_000, sensor=sensor)[:count])
    return write_text(path / "run.csv", {**columns, **more})


def holed(values, *places):
    """Return cells of which some are blank."""
    return ["" if place in places else value for place, value in enumerate(values.tolist())]


def test_rows_that_lack_a_sensor_are_left_out_and_told(tmp_path):
    """The others are whole; with partial samples they stay, with what they lack."""
    columns = columns_of("mag1_", turned(48_000, sensor=1))
    path = table(tmp_path, mag1_y=holed(columns["mag1_y"], 3, 7, 399))
    source, usage = read_source(path)
    assert source.sample_count == 397 and (usage.used, usage.received) == (397, 400)
    assert usage.missing == ("3 of 400 readings of sensor 2 are NaN or blank, first at 0.15, 0.35, 19.95 s",)
    partial = read_samples(path, reading=Reading(with_partial=True))
    assert partial.recording.sample_count == 400 and np.flatnonzero(partial.missing).tolist() == [3, 7, 399]
    assert partial.missing[3] == 2


def test_a_channel_without_any_reading_is_told(tmp_path):
    """A scalar that is blank throughout gives no scale; a slow one is blank in most rows, which is no fault."""
    _, usage = read_source(table(tmp_path, scalar_nT=[""] * 400))
    assert usage.warnings() == ("all 400 readings of the scalar are missing",)
    slow = [48_000 if place % 20 == 0 else "" for place in range(400)]
    assert read_source(table(tmp_path, scalar_nT=slow))[1] == NO_USAGE


@pytest.mark.parametrize("size", [1 << 24, 3000])
def test_sensors_that_are_read_in_turn_are_joined_by_time(tmp_path, monkeypatch, size):
    """Where few rows hold all: each is interpolated to the others' times, as messages are, also in pieces."""
    monkeypatch.setattr(text_source, "PIECE", size)
    first, second = (columns_of(f"mag{sensor}_", turned(48_000)) for sensor in (0, 1))
    even, odd = range(0, 400, 2), range(1, 400, 2)
    columns = {name: holed(values, *odd) for name, values in first.items()}
    columns |= {name: holed(values, *even) for name, values in second.items()}
    path = table(tmp_path, **columns)
    recording = read_recording(path)
    # Values are interpolated once three intervals of a stream are known.
    assert recording.sample_count == 200 - 4
    assert_allclose(recording.readings_T[:, 0], recording.readings_T[:, 1], atol=2e-6)
    pieces = [each.recording for each in read_pieces(path)]
    for name, values in recording.values().items():
        assert_array_equal(np.concatenate([each.values()[name] for each in pieces]), values)


def test_pieces_are_the_whole(tmp_path, monkeypatch):
    """Of a large file, with the missing readings of all pieces in the last."""
    columns = columns_of("mag1_", turned(48_000, sensor=1))
    path = table(tmp_path, mag1_y=holed(columns["mag1_y"], 3, 7, 399))
    whole = read_samples(path)
    monkeypatch.setattr(text_source, "PIECE", 3000)
    pieces = list(read_pieces(path))
    assert len(pieces) > 3
    for name, values in whole.recording.values().items():
        assert_array_equal(np.concatenate([each.recording.values()[name] for each in pieces]), values)
    assert pieces[-1].usage == whole.usage


def test_readings_are_turned_into_the_axes_of_the_array(tmp_path):
    """By the rotations of its mounting."""
    rotations = Rotation.from_euler("z", [[90], [0]], degrees=True)
    array = Array(np.array([[0.25, 0, 0], [-0.25, 0, 0]]), mounting=Mounting(rotations.as_quat()))
    path = table(tmp_path)
    plain, mounted = read_recording(path).readings_T, read_recording(path, array=array).readings_T
    assert_allclose(mounted[:, 0], rotations[0].apply(plain[:, 0]), atol=1e-18)
    assert_array_equal(mounted[:, 1], plain[:, 1])


@pytest.mark.parametrize("files", [1, 2])
def test_what_is_repaired_of_times_is_told_once(tmp_path, caplog, files):
    """Also where each sensor has a file of its own."""
    whole = np.floor(TIME)
    if files == 1:
        path, map = table(tmp_path, time_s=whole), None
    else:
        for sensor in (0, 1):
            columns = {"time_s": whole, **columns_of("mag_", turned(48_000, sensor=sensor))}
            write_text(tmp_path / f"CH{sensor}.csv", columns)
        path = tmp_path / "CH0.csv"
        map = {"sensors": [{"file": f"CH{sensor}.csv", "columns": [2, 3, 4], "unit": "nT"} for sensor in (0, 1)]}
    with caplog.at_level(logging.WARNING):
        assert read_recording(path, map=map).sample_count == 400
    told = [record.getMessage() for record in caplog.records if "too few digits" in record.getMessage()]
    assert len(told) == files and all("20 samples share each" in each for each in told)


def test_no_time_at_all_is_told(tmp_path, caplog):
    """Rows are a second apart; a map that states the rate says nothing."""
    path = write_text(tmp_path / "run.csv", columns_of("mag_", turned(48_000)))
    with caplog.at_level(logging.WARNING):
        assert_array_equal(read_recording(path).time_s, np.arange(400.0))
    assert "without a time, rows count as 1 s apart and rates mean nothing" in caplog.text
    caplog.clear()
    map = {"sensors": [{"columns": ["mag_x", "mag_y", "mag_z"]}], "time": {"rate_hz": 25}}
    assert_allclose(read_recording(path, map=map).time_s, np.arange(400) / 25)
    assert not [record for record in caplog.records if record.levelno >= logging.WARNING]


def test_times_in_seconds_stand_as_they_are(tmp_path):
    """To the last digit of a double."""
    exact = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.02, 400))
    path = table(tmp_path, time_s=[repr(value) for value in exact.tolist()])
    assert_array_equal(read_recording(path).time_s, exact)


@pytest.mark.parametrize(
    "time",
    [
        {"time_us": np.arange(400) * 30_000 % 2**22 * 4},
        {"time_s": np.floor(TIME)},
        {"date": [f"2024-05-14T10:{minute:02d}:{second:02d}" for minute, second in np.ndindex(7, 60)][:400]},
        {},
    ],
    ids=["counter that wraps", "whole seconds", "dates", "none"],
)
@pytest.mark.parametrize("window", [(None, None), (5, 60), (150, None)])
def test_times_of_pieces_are_those_of_the_whole(tmp_path, monkeypatch, time, window):
    """A counter that wraps in one piece goes on in the next, and a part is the same part."""
    path = write_text(tmp_path / "run.csv", {**time, **columns_of("mag_", turned(48_000))})
    reading = Reading(window=Window.of(*window))
    found = []
    for size in (1 << 24, 3000):
        monkeypatch.setattr(text_source, "PIECE", size)
        try:
            pieces = list(read_pieces(path, reading=reading))
        except InputError as problem:
            found.append(str(problem))
        else:
            found.append(np.concatenate([each.recording.time_s for each in pieces]).tolist())
    assert found[0] == found[1]
