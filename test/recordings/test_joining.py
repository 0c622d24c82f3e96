"""Streams of a recording joined off line are the samples that the collector makes of the same messages on line."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inspected import START_NS, fields, numbers, turned, write_bag
from numpy.testing import assert_allclose, assert_array_equal
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.typesys import Stores, get_typestore

from tam_calibration import inspect
from tam_calibration.messages.missing import MOST_MISSING, codes_of
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.synchroniser import Synchroniser
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import read_recording
from tam_calibration.recordings.channel_map import AS_IT_IS, Pick
from tam_calibration.recordings.fit_input import read_source
from tam_calibration.recordings.joining import PATIENCE_NS, Joining, Streams
from tam_calibration.recordings.recording_file import read_pieces, read_samples
from tam_calibration.recordings.tables import Columns, MemorySource, Table, Wanted

MS = 1_000_000
ROS1 = get_typestore(Stores.ROS1_NOETIC)
FIELD = "sensor_msgs/msg/MagneticField"
AXES = ("x", "y", "z")


def streams(source):
    """Return what is read of a source of two sensors in tesla and a scalar in nT."""
    wanted = {
        name: Wanted(table, table.fields)
        for name, table in zip(("tam_1", "tam_2", "scalar"), source.tables, strict=True)
    }
    picks = {
        "tam_1": Pick(topic="/a", unit="T"),
        "tam_2": Pick(topic="/b", unit="T"),
        "scalar": Pick(topic="/f", unit="nT"),
    }
    return Streams(wanted, picks, "stamp")


def source_of(stamps, values):
    """Return a source in memory of two sensors and a scalar."""
    tables = [Table("/a", AXES), Table("/b", AXES), Table("/f", ("data",))]
    columns = [
        Columns(table, each, dict(zip(table.fields, numbers.T, strict=True)))
        for table, each, numbers in zip(tables, stamps, values, strict=True)
    ]
    return MemorySource("memory", "log", columns)


@settings(deadline=None, max_examples=15)
@given(
    seed=st.integers(0, 2**32 - 1),
    jitter_ms=st.sampled_from([0.0, 2.0, 8.0]),
    lost=st.sampled_from([0.0, 0.05, 0.2]),
    missing=st.sampled_from([0.0, 0.05, 0.3]),
)
def test_samples_are_those_of_the_collector(seed, jitter_ms, lost, missing):
    """With jitter, lost messages, and readings that are NaN, zero or 1e300: the same stamps and values."""
    rng = np.random.default_rng(seed)
    stamps, values = [], []
    for sensor in range(3):
        kept = np.flatnonzero(rng.random(80) >= lost)
        stamps.append(START_NS + kept * 50 * MS + (rng.random(len(kept)) * jitter_ms * MS).astype(np.int64))
        own = turned(sensor=sensor, count=80)[kept]
        odd = rng.random(len(kept)) < missing
        own[odd] = np.array([np.nan, 0.0, 1e300])[rng.integers(0, 3, odd.sum()), None]
        values.append(own if sensor < 2 else np.full((len(kept), 1), 48_000.0))
    source = source_of(stamps, values)
    online = Synchroniser(
        SampleLayout(2, ("scalar",)), 0, PATIENCE_NS, PATIENCE_NS, expected=("scalar",), capacity=1 << 24
    )
    order = sorted((stamp, number, row) for number, own in enumerate(stamps) for row, stamp in enumerate(own.tolist()))
    samples = []
    for stamp, number, row in order:
        name = ("tam_1", "tam_2", "scalar")[number]
        reading = tuple(float(value) * (1e-9 if number == 2 else 1) for value in values[number][row])
        if not codes_of(name, np.array([reading]))[0]:
            samples += online.push(name, stamp, reading)
        else:
            online.refuse(name)
    samples += online.flush()
    joining = Joining(source, streams(source), AS_IT_IS, None)
    if max(np.mean(codes_of("tam_1", own) > 0) for own in values[:2]) > MOST_MISSING:
        with pytest.raises(InputError, match="more than half"):
            joining.whole(lambda done, total: None)
        return
    found = joining.whole(lambda done, total: None)
    assert found.stamps_ns.tolist() == [sample.stamp_ns for sample in samples]
    assert_allclose(found.recording.readings_T.reshape(-1, 6), [sample.values[:6] for sample in samples], rtol=1e-12)
    assert (found.usage.used, found.usage.received) == (online.usage.used, online.usage.received)


@pytest.fixture
def bag(tmp_path):
    """Write a bag of two sensors and a scalar, whose second sensor is missing one in ten readings; return its path."""
    stamps = START_NS + 50 * MS * np.arange(400)
    readings = [turned(), turned(sensor=1)]
    readings[1][::10] = np.nan
    readings[1][5] = 0
    topics = {f"/mag{number}": (fields(own, stamps), stamps) for number, own in enumerate(readings)}
    scalar = numbers(np.full(400, 48_000.0)), stamps
    return write_bag(tmp_path / "bag", {**topics, "/scalar": scalar}, StoragePlugin.SQLITE3)


def test_pieces_are_the_whole(bag, monkeypatch):
    """Batch by batch the same samples, without one lost or doubled, and the usage of all in the last."""
    whole = read_samples(bag)
    monkeypatch.setattr("tam_calibration.recordings.bag_source.BATCH", 100)
    monkeypatch.setattr("tam_calibration.recordings.bag_sqlite3.ROWS", 100)
    monkeypatch.setattr("tam_calibration.messages.cdr.COUNT", 100)
    pieces = list(read_pieces(bag))
    assert len(pieces) > 2
    assert_array_equal(np.concatenate([each.stamps_ns for each in pieces]), whole.stamps_ns)
    assert_array_equal(np.concatenate([each.recording.readings_T for each in pieces]), whole.recording.readings_T)
    assert pieces[-1].usage == whole.usage


def test_missing_readings_are_told_with_the_usage(bag):
    """By sensor and reason, with times from the start."""
    usage = read_source(bag)[1]
    assert usage.missing == (
        "40 of 400 readings of sensor 2 are NaN or blank, first at 0.00, 0.50, 1.00 s",
        "1 of 400 readings of sensor 2 is zero on all axes, first at 0.25 s",
    )


def test_more_than_half_missing_is_an_error(tmp_path):
    """In one sentence with the file, the sensor and the reason."""
    readings, stamps = turned(), START_NS + 50 * MS * np.arange(400)
    readings[:201] = 0
    path = write_bag(tmp_path / "bag", {"/mag": (fields(readings, stamps), stamps)})
    with pytest.raises(InputError, match="bag: more than half of the readings of sensor 1 are missing: 201 of 400"):
        read_recording(path)


def test_stamps_of_no_common_clock_are_told(tmp_path):
    """The sentence asks for the clock; the recorder's times join them."""
    stamps = START_NS + 50 * MS * np.arange(400)
    topics = {
        f"/mag{number}": (fields(turned(sensor=number), own), stamps)
        for number, own in enumerate((stamps, stamps - 10**15))
    }
    path = write_bag(tmp_path / "bag", topics)
    with pytest.raises(InputError, match="no sample could be joined by the stamps of the topics"):
        read_recording(path)
    recording = read_recording(path, map={"sensors": [{"topic": "/mag0"}, {"topic": "/mag1"}], "time": "received"})
    assert recording.sample_count == 400


@pytest.mark.parametrize("publishers", [1, 2, 3])
def test_all_publishers_of_a_topic_in_ros1_are_read(tmp_path, publishers):
    """Each has a connection of its own; their number is told, and no message is lost."""
    readings, stamps = turned(count=120), START_NS + 50 * MS * np.arange(120)
    types = ROS1.types
    with Ros1Writer(tmp_path / "run.bag") as writer:
        connections = [
            writer.add_connection("/mag", FIELD, typestore=ROS1, callerid=f"/driver_{number}")
            for number in range(publishers)
        ]
        for number, (reading, stamp) in enumerate(zip(readings, stamps.tolist(), strict=True)):
            header = types["std_msgs/msg/Header"](
                number, types["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "mag"
            )
            message = types[FIELD](header, types["geometry_msgs/msg/Vector3"](*reading), np.zeros(9))
            writer.write(connections[number % publishers], stamp, ROS1.serialize_ros1(message, FIELD))
    assert_array_equal(read_recording(tmp_path / "run.bag").readings_T[:, 0], readings)
    found = inspect(tmp_path / "run.bag")
    told = [each for each in found.oddities if "publishers wrote to it" in each]
    assert told == ([] if publishers == 1 else [f"/mag: {publishers} publishers wrote to it"])
    assert found.tables[0].count == 120


def test_a_slower_stream_counts_once(tmp_path):
    """A sensor at a tenth of the rate: its readings count, not the values between them."""
    fast, slow = START_NS + 10 * MS * np.arange(1000), START_NS + 100 * MS * np.arange(100)
    topics = {
        "/mag0": (fields(turned(count=1000), fast), fast),
        "/mag1": (fields(turned(count=1000)[::10], slow), slow),
    }
    path = write_bag(tmp_path / "bag", topics)
    # Values are interpolated once three intervals of the slow stream are known: not before 0.3 s, nor after its last.
    assert read_samples(path).recording.sample_count == 1000 - 27 - 9
    assert read_source(path)[0].sample_count == 100
