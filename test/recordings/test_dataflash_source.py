"""Logs of ArduPilot that the test writes byte by byte: what they hold is what was written, and damage costs little."""

import struct
import tracemalloc
from time import process_time

import numpy as np
import pytest
from foreign.logs import LOGS, described, packed
from inspected import turned
from pymavlink.DFReader import DFReader_binary

from tam_calibration import inspect, read_recording
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.dataflash_source import DataFlashReader
from tam_calibration.recordings.recording_file import open_source

ITSELF = described(128, "FMT", "BBnNZ", "Type,Length,Name,Format,Columns")
MAG = "TimeUS,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,Health"
COUNT = 60


def defined(kind, name, letters, columns, length):
    """Return the message that describes another of some length."""
    return packed(128, "<BB4s16s64s", kind, length, name.encode(), letters.encode(), columns.encode())


def mag(kind, sample, reading, offset=(0, 0, 0)):
    """Return a reading in milligauss, to which an offset was added."""
    return packed(kind, "<Q6hB", 1_000_000 + 100_000 * sample, *np.add(reading, offset), *offset, 1)


def readings(count=COUNT):
    """Return whole milligauss."""
    return np.round(turned(480, count)).astype(int)


def data(kind=34, offset=(0, 0, 0)):
    """Return some readings of one magnetometer."""
    return [mag(kind, sample, reading, offset) for sample, reading in enumerate(readings())]


def write(path, *parts):
    """Write a log of these messages, and return its path."""
    path = path / "00000001.BIN"
    path.write_bytes(ITSELF + b"".join(parts))
    return path


def columns(path, name, *fields, instance=0):
    """Return stamps and some fields of a message, with its table and the log."""
    with open_source(path) as source:
        each = next(each for each in source._columns.values() if each.table.key == (name, instance))
        return each.stamps_ns, each.rows(fields, np.arange(len(each.stamps_ns))), each.table, source


@pytest.fixture(autouse=True)
def is_installed(monkeypatch):
    """Let logs be read also where the package was installed before it read them."""
    monkeypatch.setattr("tam_calibration.recordings.recording_file._readers", lambda: (DataFlashReader(),))


def test_each_type_of_number_is_read(tmp_path):
    """Hundredths and degrees as such; texts are none."""
    first, second = "QbBhHiIfdg", "QcCeELMqnNZa"
    names = {letter: f"v{ord(letter)}" for letter in f"{first}{second}"} | {"Q": "TimeUS"}
    plain = (-1, 255, -300, 60_000, -70_000, 4_000_000_000, 0.5, 1e300, 1.5)
    scaled = (-12_345, 54_321, -1_234_567, 3_000_000_000, 481_234_567, 4, -5)
    parts = [
        packed(50, "<QbBhHiIfde", 7, *plain),
        packed(51, "<QhHiIiBq4s16s64s64s", 7, *scaled, b"abc", b"text", b"more", b""),
    ]
    begin = [
        defined(50 + kind, f"TST{kind}", letters, ",".join(map(names.get, letters)), len(parts[kind]))
        for kind, letters in enumerate((first, second))
    ]
    log = write(tmp_path, *begin, *parts)
    for name, letters, values in (
        ("TST0", first[1:], plain),
        ("TST1", second[1:8], (-123.45, 543.21, -12_345.67, 30_000_000, 48.1234567, 4, -5)),
    ):
        fields = tuple(names[letter] for letter in letters)
        stamps_ns, found, table, source = columns(log, name, *fields)
        assert (table.fields, source.format, source.unfinished) == (fields, "ArduPilot log", "")
        assert stamps_ns.tolist() == [7000] and found[0].tolist() == list(values)


def test_magnetometers_are_sensors_in_milligauss(tmp_path):
    """MAG, MAG2 and MAG3 in this order, without the offsets that ArduPilot has added."""
    kinds = {34: "MAG", 35: "MAG2", 36: "MAG3"}
    begin = [described(kind, name, "QhhhhhhB", MAG) for kind, name in kinds.items()]
    each = [data(kind, (30 * kind, -40, 50)) for kind in kinds]
    log = write(tmp_path, *begin, *(part for parts in zip(*each, strict=True) for part in parts))
    stamps_ns, values, table, _ = columns(log, "MAG2", "MagX", "OfsX", "RawX")
    np.testing.assert_array_equal(stamps_ns, 1_000_000_000 + 100_000_000 * np.arange(COUNT))
    np.testing.assert_array_equal(values[:, 0] - values[:, 1], values[:, 2])
    assert values[0, 1] == 30 * 35 and table.units["RawX"] == table.units["MagX"] == "mG"
    found = inspect(log)
    assert found.is_certain and [pick.topic for pick in found.channel_map.sensors] == ["MAG", "MAG2", "MAG3"]
    taken = read_recording(log).readings_T
    np.testing.assert_allclose(taken, np.repeat(readings()[:, None], 3, axis=1) * 1e-7, rtol=1e-12)


def test_instances_are_sensors(tmp_path):
    """Where the log states which number tells them apart, also of quaternions, which go from north-east-down."""
    parts = [
        described(130, "FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds"),
        described(34, "MAG", "QBhhhhhhB", MAG.replace("TimeUS,", "TimeUS,I,")),
        defined(35, "XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", 28),
        packed(130, "<QB16s16s", 0, 34, b"s#GGGGGG-", b"F-CCCCCC-"),
        packed(130, "<QB16s16s", 0, 35, b"s#????", b"F-0000"),
        packed(130, "<QB16s16s", 0, 99, b"s#????", b"F-0000"),
    ]
    for sample, reading in enumerate(readings()):
        time_us = 1_000_000 + 100_000 * sample
        parts += [packed(34, "<QB6hB", time_us, number, *(reading + number), 0, 0, 0, 1) for number in (0, 2)]
        parts.append(packed(35, "<QB4f", time_us, 0, 1, 0, 0, 0))
    log = write(tmp_path, *parts)
    taken = read_recording(log)
    np.testing.assert_allclose(taken.readings_T[:, 1], (readings() + 2) * 1e-7, rtol=1e-12)
    np.testing.assert_allclose(np.abs(taken.attitude[1]), [0.5**0.5, 0.5**0.5, 0, 0], atol=1e-7)
    instances = [pick.instance for pick in inspect(log).channel_map.sensors]
    assert instances == [0, 2]


def test_times_in_milliseconds_are_read(tmp_path):
    """As logs of 2014 have them."""
    log = write(tmp_path, described(50, "IMU", "Ih", "TimeMS,GyrX"), packed(50, "<Ih", 25, 3))
    assert columns(log, "IMU", "GyrX")[0].tolist() == [25_000_000]


def test_pymavlink_reads_the_same(tmp_path):
    """All numbers of the log of another writer."""
    path = LOGS[1].write(tmp_path)
    log = DFReader_binary(str(path))
    rows = {(0, "ATT"): [], **{(number, "MAG"): [] for number in range(3)}}
    while (message := log.recv_msg()) is not None:
        if message.get_type() in ("ATT", "MAG"):
            rows[getattr(message, "I", 0), message.get_type()].append(message.to_dict())
    log.filehandle.close()
    for (instance, name), those in rows.items():
        names = [each for each in those[0] if each not in ("mavpackettype", "TimeUS", "I")]
        stamps_ns, values, *_ = columns(path, name, *names, instance=instance)
        np.testing.assert_array_equal(stamps_ns, [1000 * each["TimeUS"] for each in those])
        np.testing.assert_array_equal(values, [[each[name] for name in names] for each in those])


@pytest.mark.parametrize("lost", [1, 5, 20, 23])
def test_a_log_that_ends_in_a_cut_message_is_read_up_to_there(tmp_path, caplog, lost):
    """And it says how much is lost."""
    log = write(tmp_path, described(34, "MAG", "QhhhhhhB", MAG), *data())
    log.write_bytes(log.read_bytes()[:-lost])
    stamps_ns, _, _, source = columns(log, "MAG", "MagX")
    told = f"the log was left unfinished or is damaged: {24 - lost} bytes of it are no complete messages"
    assert len(stamps_ns) == COUNT - 1 and source.unfinished == told and caplog.messages == [f"{log}: {told}"]


@pytest.mark.parametrize("spoil", [bytes(528), b"\xff" * 40, b"\xa3\x95", b"\xa3\x95\x77" * 9, b"\xa3" * 7])
def test_damage_costs_only_itself(tmp_path, spoil):
    """What stands between messages or behind them, and their beginning within another, where it is a number."""
    held = mag(34, 60, struct.unpack("<3h", b"\xa3\x95\x22\xa3\x95\x22"))
    log = write(tmp_path, described(34, "MAG", "QhhhhhhB", MAG), *data()[:30], spoil, *data()[30:], held, spoil)
    stamps_ns, _, _, source = columns(log, "MAG", "MagX")
    np.testing.assert_array_equal(stamps_ns, 1_000_000_000 + 100_000_000 * np.arange(COUNT + 1))
    assert f"{2 * len(spoil)} bytes of it are no complete messages" in source.unfinished


def test_the_first_definition_holds(tmp_path):
    """One that comes again, is another or contradicts itself changes nothing."""
    good = described(34, "MAG", "QhhhhhhB", MAG)
    others = [good, described(34, "GYR", "Qh", "TimeUS,X"), described(40, "MAG", "Qh", "TimeUS,MagX")]
    bad = [
        defined(41, "SIZE", "Qh", "TimeUS,X", 99),
        defined(42, "TEXT", "Q?", "TimeUS,X", 12),
        defined(43, "LESS", "Qhh", "TimeUS,X", 15),
        defined(44, "SAME", "Qhh", "TimeUS,X,X", 15),
        defined(45, "NONE", "", "", 0),
        defined(46, "HEAD", "", "", 3),
    ]
    log = write(tmp_path, good, *others, *bad, *data(), packed(43, "<Qhh", 1, 2, 3), packed(46, "<"))
    with open_source(log) as source:
        assert [(table.name, table.count) for table in source.tables] == [("MAG", COUNT)]
        assert source.unfinished == ""


@pytest.mark.parametrize(
    "parts",
    [
        [],
        [b"\xa3\x95\x80"],
        [bytes(100_000)],
        [b"\xa3\x95" * 50_000],
        [b"\xa3\x95\x80" * 50_000],
        [defined(34, "A", "", "", 0), b"\xa3\x95\x22" * 50_000],
        [defined(34, "A", "", "", 3), b"\xa3\x95\x22" * 50_000],
        [defined(34, "A", "", "", 4), b"\xa3\x95\x22" * 50_000],
        [defined(34, "MAG", "dh", "TimeUS,X", 13), packed(34, "<dh", 1.0, 2)],
        [described(34, "A", "Qh", "TimeUS,X"), packed(34, "<Qh", 2**64 - 1, 1)],
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
    assert "00000001.BIN" in str(told.value) and "\n" not in str(told.value) and len(str(told.value)) < 300
