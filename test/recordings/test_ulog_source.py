"""Logs of PX4 that the test writes byte by byte: what they hold is what was written, and damage ends in a sentence."""

import struct
import tracemalloc
from time import process_time

import numpy as np
import pytest
from foreign.logs import LOGS, ulog_message
from inspected import turned
from pyulog import ULog

from tam_calibration import inspect, read_recording
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.recording_file import open_source
from tam_calibration.recordings.ulog_source import UlogReader

HEAD = b"ULog\x01\x12\x35\x01" + bytes(8)
FLAGS = ulog_message("B", bytes(40))
MARK = ulog_message("S", bytes.fromhex("2f731320250cbb12"))
MAG = "sensor_mag:uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;float x;float y;float z;"
NESTED = [
    "part:int16_t count;uint8_t[2] _padding0;float level;",
    "probe:uint64_t timestamp;part[2] parts;char[3] name;double wide;bool is_on;uint8_t[4] _padding0;",
]
COUNT = 60


def formats(*texts):
    """Return the messages that define others."""
    return b"".join(ulog_message("F", text.encode()) for text in texts)


def added(number, name, instance=0):
    """Return the message that begins a topic."""
    return ulog_message("A", struct.pack("<BH", instance, number) + name.encode())


def mag(number, sample, reading, sample_us=None):
    """Return a reading of a magnetometer in gauss, which was made 150 µs before it was published."""
    time_us = 1_000_000 + 20_000 * sample
    sample_us = time_us if sample_us is None else sample_us
    content = struct.pack("<HQQI3f", number, time_us + 150, sample_us, 7, *reading)
    return ulog_message("D", content)


def data(count=COUNT, number=0, first=0):
    """Return some readings of one magnetometer, with marks between."""
    readings = turned(0.48, count + first)[first:]
    return [mag(number, first + sample, reading) + MARK * (sample % 20 == 0) for sample, reading in enumerate(readings)]


def write(path, *parts):
    """Write a log of these messages, and return its path."""
    path = path / "flight.ulg"
    path.write_bytes(HEAD + b"".join(parts))
    return path


def columns(path, name, *fields, instance=0):
    """Return stamps and some fields of a topic, with its table and the log."""
    with open_source(path) as source:
        each = next(each for each in source._columns.values() if each.table.key == (name, instance))
        return each.stamps_ns, each.rows(fields, np.arange(len(each.stamps_ns))), each.table, source


@pytest.fixture(autouse=True)
def is_installed(monkeypatch):
    """Let logs be read also where the package was installed before it read them."""
    monkeypatch.setattr("tam_calibration.recordings.recording_file._readers", lambda: (UlogReader(),))


def test_each_number_of_nested_messages_is_read(tmp_path):
    """By its path, with what pads the messages left out, also at the end of those that are logged without it."""
    content = struct.pack("<HQhHfhHf3sd?", 5, 9, -3, 0, 0.5, 4, 0, -1.5, b"abc", 1e300, True)
    log = write(tmp_path, FLAGS, formats(*NESTED), added(5, "probe"), ulog_message("D", content))
    fields = ("parts[0].count", "parts[0].level", "parts[1].count", "parts[1].level", "wide", "is_on")
    stamps_ns, values, table, source = columns(log, "probe", *fields)
    assert (table.fields, table.count, source.format, source.unfinished) == (fields, 1, "PX4 log", "")
    assert stamps_ns.tolist() == [9000] and values.tolist() == [[-3, 0.5, 4, -1.5, 1e300, 1]]


def test_magnetometers_are_sensors_in_gauss(tmp_path):
    """Each instance is one, at the times at which its readings were made; the one that PX4 corrected is not taken."""
    corrected = "vehicle_magnetometer:uint64_t timestamp;float[3] magnetometer_ga;"
    both = [part for pair in zip(data(number=0), data(number=1), strict=True) for part in pair]
    other = [
        ulog_message("D", struct.pack("<HQ3f", 2, 1_000_000 + 20_000 * sample, *reading))
        for sample, reading in enumerate(turned(0.5, COUNT))
    ]
    begin = [added(0, "sensor_mag"), added(1, "sensor_mag", 1), added(2, "vehicle_magnetometer")]
    log = write(tmp_path, FLAGS, formats(MAG, corrected), *begin, *both, *other)
    stamps_ns, values, table, _ = columns(log, "sensor_mag", "x", "y", "z", instance=1)
    assert table.units == {"x": "G", "y": "G", "z": "G"} and "timestamp" not in table.fields
    np.testing.assert_array_equal(stamps_ns, 1_000_000_000 + 20_000_000 * np.arange(COUNT))
    np.testing.assert_array_equal(values, turned(0.48, COUNT).astype("<f4"))
    found = inspect(log)
    assert found.is_certain and "vehicle_magnetometer" in found.remarks[0]
    assert [(pick.topic, pick.instance) for pick in found.channel_map.sensors] == [("sensor_mag", 0), ("sensor_mag", 1)]
    np.testing.assert_allclose(read_recording(log).readings_T[:, 1], values * 1e-4)


def test_readings_without_a_time_have_that_of_the_message(tmp_path):
    """As drivers that do not know it write 0."""
    parts = [mag(0, sample, (0.1, 0.2, 0.3), sample_us=0) for sample in range(3)]
    log = write(tmp_path, FLAGS, formats(MAG), added(0, "sensor_mag"), *parts)
    assert columns(log, "sensor_mag", "x")[0].tolist() == [1_000_150_000, 1_020_150_000, 1_040_150_000]


def test_attitude_goes_from_north_east_down(tmp_path):
    """PX4's quaternions begin with the real part, and turn the body into north-east-down: level to the north."""
    text = "vehicle_attitude:uint64_t timestamp;float[4] q;"
    level = [
        ulog_message("D", struct.pack("<HQ4f", 1, 1_000_000 + 20_000 * sample, 1, 0, 0, 0)) for sample in range(COUNT)
    ]
    log = write(
        tmp_path, FLAGS, formats(MAG, text), added(0, "sensor_mag"), added(1, "vehicle_attitude"), *data(), *level
    )
    attitude = read_recording(log).attitude[1]
    np.testing.assert_allclose(np.abs(attitude), [0.5**0.5, 0.5**0.5, 0, 0], atol=1e-7)


def test_pyulog_reads_the_same(tmp_path):
    """All numbers and times of the log of another writer."""
    path = LOGS[0].write(tmp_path)
    with open_source(path) as source:
        assert len(source.tables) == len(ULog(str(path)).data_list) == 5
    for each in ULog(str(path)).data_list:
        names = [name for name in each.data if "timestamp" not in name]
        stamps_ns, values, *_ = columns(path, each.name, *names, instance=each.multi_id)
        np.testing.assert_array_equal(stamps_ns, 1000 * each.data["timestamp_sample"].astype(int))
        np.testing.assert_array_equal(values, np.column_stack([each.data[name] for name in names]))


@pytest.mark.parametrize("lost", [1, 2, 5, 30])
def test_a_log_that_ends_in_a_cut_message_is_read_up_to_there(tmp_path, caplog, lost):
    """And it says how much is lost."""
    log = write(tmp_path, FLAGS, formats(MAG), added(0, "sensor_mag"), *data())
    whole = log.read_bytes()
    log.write_bytes(whole[:-lost])
    stamps_ns, _, _, source = columns(log, "sensor_mag", "x")
    rest = len(data()[-1]) - lost
    told = f"the log was left unfinished or is damaged: {rest} bytes of it are no complete messages"
    assert len(stamps_ns) == COUNT - 1 and source.unfinished == told
    assert caplog.messages == [f"{log}: {told}"]


@pytest.mark.parametrize("spoil", [bytes(40), b"\xff" * 40, b"\xff\xffD" * 20, b"noise"])
def test_after_damage_it_goes_on_at_the_next_mark(tmp_path, spoil):
    """What stands between is lost and counted."""
    log = write(tmp_path, FLAGS, formats(MAG), added(0, "sensor_mag"), *data(30), spoil, *data(30, first=30))
    stamps_ns, _, _, source = columns(log, "sensor_mag", "x")
    assert 30 + 20 <= len(stamps_ns) < 60 and "no complete messages" in source.unfinished
    assert stamps_ns[-1] == 1_000_000_000 + 20_000_000 * 59


def test_what_was_appended_after_a_crash_is_read(tmp_path):
    """The flags say where it begins, behind a message that is cut."""
    begin = formats(MAG) + added(0, "sensor_mag")
    first = begin + b"".join(data(30))[:-7]
    place = len(HEAD) + len(FLAGS) + len(first)
    flags = ulog_message("B", bytes(8) + b"\1" + bytes(7) + struct.pack("<3Q", place, 0, 0))
    log = write(tmp_path, flags, first, *data(30, first=30))
    assert len(columns(log, "sensor_mag", "x")[0]) == 59


def test_a_log_of_a_later_kind_is_refused(tmp_path):
    """Where its flags say that it must not be read as usual."""
    log = write(
        tmp_path, ulog_message("B", bytes(8) + b"\2" + bytes(31)), formats(MAG), added(0, "sensor_mag"), *data()
    )
    with pytest.raises(InputError, match=r"flight.ulg.* is a ULog of a later kind"):
        inspect(log)


def wide(depth, width=9999):
    """Return formats of lists of lists."""
    return formats(*(f"f{level}:f{level + 1}[{width}] a;" for level in range(depth)), f"f{depth}:uint8_t a;")


@pytest.mark.parametrize(
    "parts",
    [
        [],
        [FLAGS],
        [b"D"],
        [bytes(100_000)],
        [FLAGS, b"\xff" * 100_000],
        [FLAGS, MARK * 20_000],
        [formats("f0:f0 a;"), added(0, "f0"), ulog_message("D", bytes(60_000))],
        [formats("f0:f1[9] a;", "f1:f0[9] a;"), added(0, "f0"), ulog_message("D", bytes(60_000))],
        [formats(*(f"f{n}:f{n + 1} a;" for n in range(3000))), added(0, "f0"), ulog_message("D", bytes(60_000))],
        [formats(*(f"f{n}:f{n + 1} a;f{n + 1} b;" for n in range(60)), "f60:bool a;"), added(0, "f0"), bytes(9)],
        [wide(6), added(0, "f0"), ulog_message("D", bytes(60_000))],
        [wide(1), *(added(n, "f0") + ulog_message("D", struct.pack("<HQ", n, n)) for n in range(9999))],
        [formats("f0:;"), added(0, "f0"), ulog_message("D", bytes(9))],
        [formats("f0:uint64_t timestamp;f1[9999] a;", "f1:;"), added(0, "f0"), ulog_message("D", bytes(99))],
        [formats("f0:float timestamp;float x;"), added(0, "f0"), ulog_message("D", bytes(10))],
        [formats("\0:\xff;", ":", "", "a:b:c;d e f;"), added(0, "\0"), ulog_message("D", bytes(10))],
    ],
)
def test_rubbish_is_one_sentence(tmp_path, parts):
    """At once, and without the memory or the time that it asks for."""
    log = write(tmp_path, *parts)
    begin = process_time()
    tracemalloc.start()
    with pytest.raises(InputError) as told:
        inspect(log)
    assert tracemalloc.get_traced_memory()[1] < 48 << 20
    tracemalloc.stop()
    assert process_time() - begin < 10
    assert "flight.ulg" in str(told.value) and "\n" not in str(told.value) and len(str(told.value)) < 300


def test_a_flight_with_one_magnetometer_is_an_array_of_one(tmp_path):
    """Without a map, and with an array file of one sensor."""
    log = write(tmp_path, FLAGS, formats(MAG), added(0, "sensor_mag"), *data())
    assert read_recording(log, array=Array(np.zeros((1, 3)))).sensor_count == read_recording(log).sensor_count == 1


def test_a_stream_that_becomes_slower_is_read_on(tmp_path):
    """PX4 logs the second reading at once, and then one each second: none of these has a false stamp."""
    at_us = 3_000_000 + np.array([0, 21_000, *range(1_000_000, 99_000_000, 1_000_000)])
    parts = [
        mag(number, 0, reading, sample_us=int(time_us) + 1800 * number)
        for time_us, reading in zip(at_us, turned(0.48, 100), strict=True)
        for number in (0, 1)
    ]
    log = write(tmp_path, FLAGS, formats(MAG), added(0, "sensor_mag"), added(1, "sensor_mag", 1), *parts)
    assert read_recording(log).sample_count >= 94
