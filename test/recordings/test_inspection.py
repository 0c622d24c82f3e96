"""What is told of a recording before anyone has described it."""

import re
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np
import pytest
import yaml
from inspected import (
    COUNT,
    PERIOD_NS,
    START_NS,
    columns_of,
    fields,
    header,
    message,
    numbers,
    times,
    turned,
    vector,
    write_bag,
    write_text,
)

from tam_calibration import inspect
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.recordings import oddities, read_recording, recording_file
from tam_calibration.recordings.channel_map import map_of, read_map
from tam_calibration.recordings.choice import resolve
from tam_calibration.recordings.oddities import Series, of_times
from tam_calibration.recordings.recording_file import open_source
from tam_calibration.recordings.tables import Table

ROOT = Path(__file__).parents[2]
ARRAY = Array(np.array([[0.25, 0, 0], [-0.25, 0, 0]]))


def text(path, columns=None, **more):
    """Write a text of one sensor in nT with a time in seconds; columns and more replace or add some."""
    known = {"time_s": times() / 1e9 - START_NS / 1e9, **columns_of("mag_", turned(48_000))}
    return write_text(path / "run.csv", {**known, **(columns or {}), **more})


def odd_of(path, readings=None, stamps_ns=None, received_ns=None):
    """Return what is odd about one topic of readings, with some stamps and times of the recorder."""
    stamps_ns = times() if stamps_ns is None else stamps_ns
    messages = fields(turned() if readings is None else readings, stamps_ns)
    received_ns = times() + 2_000_000 if received_ns is None else received_ns
    return inspect(write_bag(path / "bag", {"/mag": (messages, received_ns)})).oddities


def only(told, words):
    """Check that one clause is told, which holds some words."""
    assert len(told) == 1 and words in told[0], told


@pytest.fixture
def robot(tmp_path):
    """Write a bag of a robot: two sensors, a scalar, an IMU, a temperature, a battery, and images; return its path."""
    stamps_ns = times()
    imus = [
        message(
            "sensor_msgs/msg/Imu",
            header(stamp_ns),
            message("geometry_msgs/msg/Quaternion", 0.0, 0.0, np.sin(angle), np.cos(angle)),
            np.zeros(9),
            vector((0, 0, 0.1)),
            np.zeros(9),
            vector((0, 0, 9.81)),
            np.zeros(9),
        )
        for angle, stamp_ns in zip(np.linspace(0, 1, COUNT), stamps_ns, strict=True)
    ]
    image = message("sensor_msgs/msg/Image", header(START_NS), 90, 120, "mono8", 0, 120, np.zeros(10_800, np.uint8))
    warm = [message("sensor_msgs/msg/Temperature", header(each), 20.0 + each % 7, 0.0) for each in stamps_ns]
    topics = {
        "/mag10": (fields(turned(sensor=1), stamps_ns), stamps_ns),
        "/mag9": (fields(turned(), stamps_ns), stamps_ns),
        "/overhauser": (numbers(48_000 + np.arange(COUNT) % 3), stamps_ns),
        "/imu/data": (imus, stamps_ns),
        "/mag9/temperature": (warm, stamps_ns),
        "/bus/current": (numbers(np.arange(COUNT) / 100), stamps_ns),
        "/camera": ([image] * 40, stamps_ns[:40]),
    }
    return write_bag(tmp_path / "robot", topics)


def test_a_recording_is_told_in_full(robot):
    """Each topic with type, count and rate; what is taken, in the order of the numbers in names, with units and why."""
    found = inspect(robot)
    assert found.is_certain and found.remarks == ()
    assert found.duration_s == pytest.approx((COUNT - 1) * PERIOD_NS / 1e9)
    tables = {table.name: table for table in found.tables}
    assert {name: (table.count, round(table.rate_hz, 6)) for name, table in tables.items()} == dict.fromkeys(
        tables, (COUNT, 20.0)
    ) | {"/camera": (40, pytest.approx(39 / found.duration_s, rel=1e-5))}
    taken = {channel.taken_as: (table.name, channel) for table in found.tables for channel in table.channels}
    assert {words: name for words, (name, _) in taken.items() if words} == {
        "sensor 1": "/mag9",
        "sensor 2": "/mag10",
        "scalar": "/overhauser",
        "attitude": "/imu/data",
        "gyroscope": "/imu/data",
        "temperature": "/mag9/temperature",
        "current": "/bus/current",
    }
    scalar, first = taken["scalar"][1], taken["sensor 1"][1]
    assert (scalar.unit, scalar.is_unit_stated, scalar.size) == ("nT", False, 48_001)
    assert (first.unit, first.is_unit_stated) == ("T", True) and first.size == pytest.approx(48e-6, rel=0.01)
    assert first.low == pytest.approx(tuple(turned().min(axis=0)))
    assert found.reasons[0] == (
        f"sensor 1: /mag9, magnetic_field, by type MagneticField; field {first.size * 1e9:.6g} nT, unit T (stated)"
    )
    assert found.reasons[2].endswith("by name; field 48001 nT, unit nT (detected by the size of the field)")


def test_images_are_counted_and_not_read(robot):
    """A topic of large messages has its count and rate, and no channels."""
    (camera,) = (table for table in inspect(robot).tables if table.name == "/camera")
    assert (camera.type, camera.count, camera.channels) == ("sensor_msgs/msg/Image", 40, ())


def test_a_map_of_a_bag_gives_the_same(robot, tmp_path):
    """What is written is read back, means the same topics and fields, states what was detected, and is read alike."""
    found = inspect(robot)
    (tmp_path / "map.yaml").write_text(found.map_yaml())
    channel_map = read_map(tmp_path / "map.yaml")
    assert channel_map == found.channel_map
    assert channel_map.scalar.unit == "nT"
    assert channel_map.gyroscope.topic == "/imu/data" and channel_map.gyroscope.field == "angular_velocity"
    chosen, mapped = read_recording(robot), read_recording(robot, map=tmp_path / "map.yaml")
    np.testing.assert_array_equal(chosen.readings_T, mapped.readings_T)
    np.testing.assert_array_equal(chosen.scalar_T, mapped.scalar_T)


@pytest.mark.parametrize("delimiter", [",", ";", "\t", " "])
@pytest.mark.parametrize("has_header", [True, False])
def test_a_map_of_a_text_gives_the_same(tmp_path, delimiter, has_header):
    """It states the dialect, the column and unit of the time and the units of fields, and is read back alike."""
    columns = {
        "t_ms": times(first_ns=0) // 1_000_000,
        **columns_of("mag_", turned(48.0)),
        "F": turned(48.0)[:, 0] * 0 + 48,
    }
    path = write_text(tmp_path / "run.txt", columns, delimiter)
    if not has_header:
        path.write_text(path.read_text().partition("\n")[2])
    found = inspect(path, array=Array(np.zeros((1, 3))))
    assert found.is_certain, found.doubts
    assert found.channel_map.text.delimiter == delimiter
    assert found.channel_map.time.format == "ms"
    assert found.channel_map.sensors[0].unit == found.channel_map.scalar.unit == "uT"
    channel_map = map_of(yaml.safe_load(found.map_yaml()))
    assert channel_map == found.channel_map
    with open_source(path, channel_map) as source:
        assert resolve(source, channel_map).wanted["tam_1"].fields == found.tables[0].channels[0].fields
    assert read_recording(path, map=channel_map).sample_count == COUNT


def test_several_files_are_one_recording(tmp_path):
    """Each becomes a sensor by its file's name, and the map joins them by time."""
    for sensor in range(2):
        columns = {"t": times(first_ns=0) / 1e9, **columns_of("B", turned(48_000, sensor=sensor))}
        write_text(tmp_path / f"CH{sensor}.csv", columns)
    files = [tmp_path / "CH0.csv", tmp_path / "CH1.csv"]
    found = inspect(files)
    assert found.is_certain and found.format == "2 files"
    assert [pick.file for pick in found.channel_map.sensors] == ["CH0.csv", "CH1.csv"]
    recording = read_recording(files[0], map=yaml.safe_load(found.map_yaml()))
    np.testing.assert_allclose(recording.readings_T[:, 1], np.round(turned(48_000, sensor=1), 2) * 1e-9)


def test_frames_settle_the_order(tmp_path):
    """Where the array states the frames of its sensors, these are taken in their order whatever the topics' names."""
    topics = {
        f"/mag{n}": (fields(turned(sensor=n), times(), frame), times()) for n, frame in enumerate(("b", "a", "c"))
    }
    write_bag(tmp_path / "bag", topics)
    array = Array(np.array([[0.25, 0, 0], [-0.25, 0, 0]]), mounting=Mounting(frame_ids=("a", "b")))
    assert [pick.topic for pick in inspect(tmp_path / "bag", array).channel_map.sensors] == ["/mag1", "/mag0"]


def test_raw_readings_go_before_those_that_were_processed(tmp_path):
    """Of one sensor's raw, plain and filtered columns the raw are taken, and it is said what is not."""
    columns = {**columns_of("mag_filtered_", turned(48_000)), **columns_of("mag_raw_", turned(48_000, sensor=1))}
    found = inspect(text(tmp_path, columns))
    assert found.is_certain
    assert [pick.columns for pick in found.channel_map.sensors] == [["mag_raw_x", "mag_raw_y", "mag_raw_z"]]
    assert found.remarks[0].endswith(
        "columns mag_x, mag_y, mag_z, columns mag_filtered_x, mag_filtered_y, mag_filtered_z"
    )
    assert inspect(text(tmp_path, columns), array=ARRAY).doubts == (
        "1 magnetic vectors are there (columns mag_raw_x, mag_raw_y, mag_raw_z), and the array has 2 sensors: "
        "name the sensors in the map",
    )


def test_a_still_sensor_shows_the_length_of_its_readings(tmp_path):
    """Not the size of its noise, which fills a ball: 300 nT of noise are no field in another unit."""
    still = np.random.default_rng(5).normal((0, 20_000, -44_000), 300, (COUNT, 3))
    assert inspect(text(tmp_path, columns_of("mag_", still))).channel_map.sensors[0].unit == "nT"


def test_numbers_without_names_are_a_guess(tmp_path):
    """Without an array it is told that their number is not certain; with one of as many sensors they are taken."""
    layout = message("std_msgs/msg/MultiArrayLayout", [], 0)
    rows = np.column_stack([turned(48_000), turned(48_000, sensor=1), np.full(COUNT, 48_000.0)])
    messages = [message("std_msgs/msg/Float64MultiArray", layout, row) for row in rows]
    path = write_bag(tmp_path / "bag", {"/adc": (messages, times())})
    guess, certain = inspect(path), inspect(path, ARRAY)
    assert not guess.is_certain and "give --array" in guess.doubts[0]
    assert certain.is_certain and certain.channel_map == guess.channel_map
    assert certain.channel_map.time == "received"
    assert certain.channel_map.sensors[1].fields == ["data[3]", "data[4]", "data[5]"]
    assert "by place" in certain.reasons[0]


def test_two_sets_are_ambiguous(tmp_path):
    """It is said, and the best guess is written with what is to be settled."""
    vectors = [columns_of(name, turned(48_000)) for name in ("mag1_", "mag2_", "magcal1_", "magcal2_")]
    columns = {name: values for vector in vectors for name, values in vector.items()}
    found = inspect(write_text(tmp_path / "run.csv", {"time_s": times() / 1e9, **columns}))
    assert not found.is_certain and found.channel_map is not None
    assert "name one in the map" in found.doubts[0]
    assert "# To settle: " in found.map_yaml()


def test_nothing_magnetic_is_not_enough(tmp_path):
    """It is said what there is, and the map is one to fill in."""
    found = inspect(write_text(tmp_path / "run.csv", {"time_s": np.arange(30), "speed": np.arange(30) % 5}))
    assert not found.is_certain and found.channel_map is None
    assert "no vector of a magnetic field is recognised" in found.doubts[0]
    assert "sensors: []" in found.map_yaml()


@pytest.mark.parametrize(
    ("size", "unit", "doubt"),
    [
        (48_000, "nT", ""),
        (0.48, "G", ""),
        (480, "mG", ""),
        (1.0, "", "seems to be normalised: state scale_nT"),
        (7e7, "", "in no unit the Earth's: state unit or scale_nT"),
    ],
)
def test_units_are_detected_by_the_size_of_the_field(tmp_path, size, unit, doubt):
    """Where one unit alone makes it the Earth's; else it is to be stated."""
    columns = {f"mag_{axis}": values for axis, values in zip("xyz", turned(size).T, strict=True)}
    found = inspect(text(tmp_path, columns))
    assert found.is_certain == (not doubt)
    assert doubt in " ".join(found.doubts)
    if unit:
        assert found.channel_map.sensors[0].unit == unit


@pytest.mark.parametrize(("topic", "is_certain"), [("/mag", True), ("/tam_1/magnetic_field", False)])
def test_a_unit_that_cannot_be_true_is_told(tmp_path, topic, is_certain):
    """Readings in gauss of a type that states tesla: the unit that fits is taken; under our names it is asked for."""
    path = write_bag(tmp_path / "bag", {topic: (fields(turned(0.48), times()), times())})
    found = inspect(path)
    assert found.channel_map.sensors[0].unit == "G"
    assert found.is_certain == is_certain
    doubt = "0.48 T as stated, which is not the Earth's: state unit G in the map"
    assert any(doubt in each for each in found.doubts) != is_certain
    assert any("unit G (detected by the size of the field)" in each for each in found.reasons)


def test_a_sound_recording_has_nothing_odd(tmp_path):
    """No clause is told of a bag and of a text."""
    assert odd_of(tmp_path) == ()
    assert inspect(text(tmp_path)).oddities == ()


def test_gaps_and_jumps_of_stamps(tmp_path):
    """A pause of the sensor is a gap; where stamps alone leap forward the clock was set."""
    late = np.where(np.arange(COUNT) < 100, 0, 3_000_000_000)
    (tmp_path / "a").mkdir()
    only(odd_of(tmp_path, None, times() + late, times() + late), "1 gaps, the longest 3.05 s at 4.95 s")
    told = odd_of(tmp_path / "a", None, times() + late)
    assert any("1 jumps of the stamps without a gap, the longest 3.05 s at 4.95 s" in each for each in told)


def test_repeated_zero_and_backward_stamps(tmp_path):
    """Each is counted, with the time of the first."""
    stamps_ns = times()
    stamps_ns[10] = stamps_ns[9]
    stamps_ns[50:53] = 0
    stamps_ns[200] = stamps_ns[190]
    told = " ".join(odd_of(tmp_path, None, stamps_ns))
    assert "3 of 400 stamps are zero" in told
    assert "1 of 396 stamps repeat the one before, first at 0.45 s" in told
    assert "stamps go back 1 times, by up to 0.45 s" in told


def test_all_stamps_zero(tmp_path):
    """The recorder's times are taken, and the map says so."""
    path = write_bag(tmp_path / "bag", {"/mag": (fields(turned(), np.zeros(COUNT)), times())})
    found = inspect(path)
    only(found.oddities, "all stamps are zero: the recorder's times are used")
    assert found.is_certain and found.channel_map.time == "received"


def test_another_clock_that_drifts(tmp_path):
    """Stamps since power-on are behind the recorder's by a constant, and a clock that runs slow drifts."""
    own_ns = np.round((times() - START_NS) * (1 - 2000e-6)).astype(np.int64) + 1_000_000_000
    told = " ".join(odd_of(tmp_path, None, own_ns))
    assert "the clock of the stamps is 1.7e+09 s behind the recorder's" in told
    drift = float(told.partition("clock of the stamps drifts by ")[2].split(" ppm")[0])
    assert drift == pytest.approx(2000, rel=0.15)


def test_sensors_without_a_common_clock_are_told(tmp_path):
    """Stamps that overlap nowhere cannot be joined: the map takes the recorder's times."""
    topics = {
        "/mag1": (fields(turned(), times()), times()),
        "/mag2": (fields(turned(sensor=1), times(first_ns=10**9)), times()),
    }
    found = inspect(write_bag(tmp_path / "bag", topics))
    assert "they have no common clock: state time: received in the map" in found.doubts[0]
    assert found.channel_map.time == "received"
    assert read_recording(tmp_path / "bag", map=found.channel_map).sample_count == COUNT


def test_two_publishers_are_told_by_what_they_leave(tmp_path):
    """Readings that alternate, several frames, and stamps that go back every second time."""
    readings = np.stack([turned(count=200), turned(count=200, sensor=20)], axis=1).reshape(-1, 3)
    stamps_ns = times() - np.where(np.arange(COUNT) % 2, 120_000_000, 0)
    messages = fields(readings[::2], stamps_ns[::2], "a") + fields(readings[1::2], stamps_ns[1::2], "b")
    order = np.concatenate([np.arange(0, COUNT, 2), np.arange(1, COUNT, 2)])
    told = " ".join(inspect(write_bag(tmp_path / "bag", {"/mag": (messages, times()[order])})).oddities)
    assert "readings alternate between two values: two publishers on one topic?" in told
    assert "messages are of several frames, a, b: two publishers?" in told
    assert "stamps go back 200 times, by up to 0.07 s, first at 0.00 s: two publishers on one topic" in told


def test_a_scalar_that_is_blank_throughout_is_told_without_a_warning(tmp_path, recwarn):
    """Its readings have no range to be outside of."""
    columns = {"time_s": times(first_ns=0) / 1e9, **columns_of("mag_", turned(48_000)), "scalar_nT": [""] * 400}
    found = inspect(write_text(tmp_path / "run.csv", columns))
    assert any("scalar: 400 of 400 readings are NaN or blank" in one for one in found.oddities)
    assert not recwarn.list


def test_missing_readings_are_counted_by_reason(tmp_path):
    """NaN, zeros on all axes, sentinels and what is far outside, each with the time of the first."""
    readings = turned()
    readings[20:25] = np.nan
    readings[40:42] = 0
    readings[60] = 1e300
    readings[80] = 3e-3
    found = inspect(write_bag(tmp_path / "bag", {"/mag": (fields(readings, times()), times())}))
    (channel,) = found.tables[0].channels
    assert dict(channel.missing) == {
        "NaN or blank": 5,
        "zero on all axes": 2,
        "sentinels": 1,
        "far outside the range of the others": 1,
    }
    assert "sensor 1: 5 of 400 readings are NaN or blank, first at 1.00 s" in found.oddities
    assert channel.high == pytest.approx(tuple(np.delete(turned(), [*range(20, 25), 40, 41, 60, 80], 0).max(axis=0)))
    assert np.nanmax(channel.course.high) == pytest.approx(3e-3)


@pytest.mark.parametrize("bits", [8, 12, 16, 24])
def test_overflows_of_counters_are_told(tmp_path, bits):
    """With the axis and the width of the counter."""
    counts = np.round(turned(0.7 * 2.0**bits, count=4000))
    counts[:, 0] = (counts[:, 0] + 2 ** (bits - 1)) % 2**bits - 2 ** (bits - 1)
    columns = {f"mag_{axis}": values for axis, values in zip("xyz", counts.T, strict=True)}
    found = inspect(text(tmp_path, {"time_s": np.arange(4000) / 20, **columns}))
    assert any("axis x jumps" in each and f"its counter of {bits} bits overflows" in each for each in found.oddities)


def test_a_sensor_slower_than_its_messages(tmp_path):
    """Readings that are published twice."""
    only(odd_of(tmp_path, np.repeat(turned(count=200), 2, axis=0)), "50 % of the readings repeat the one before")


def test_a_channel_that_never_changes(tmp_path):
    """A sensor that is dead."""
    assert any("readings never change" in each for each in odd_of(tmp_path, np.full((COUNT, 3), 3e-5)))


@pytest.mark.parametrize(
    ("time", "words"),
    [
        (np.arange(COUNT) // 20, "the times have too few digits: 20 samples share each"),
        (np.arange(COUNT) * 100_000 % 2**24, "its counter of 24 bits wrapped"),
        (np.arange(COUNT) // 20 * 20 + np.arange(COUNT) % 20 // 19 * 0.5, "the times have too few digits"),
    ],
)
def test_times_of_rows_that_are_repaired(tmp_path, time, words):
    """It is said what was repaired."""
    known = {"time": time} if time.max() < 2**23 else {"time_us": time}
    columns = {**known, **columns_of("mag_", turned(48_000))}
    assert words in " ".join(inspect(write_text(tmp_path / "run.csv", columns)).oddities)


def test_times_that_go_back_have_to_be_settled(tmp_path):
    """The rest is shown all the same, and what to state is said."""
    found = inspect(text(tmp_path, {"time_s": np.concatenate([np.arange(200), np.arange(200)]) / 20}))
    assert not found.is_certain
    assert "time goes backwards at sample 201" in found.doubts[0] and "rate_hz" in found.doubts[0]
    assert found.tables[0].channels[0].taken_as == "sensor 1"


def test_no_time_is_told_and_can_be_stated(tmp_path):
    """The map has no rate, as none was measured; what is odd tells the line that states it."""
    found = inspect(write_text(tmp_path / "run.csv", columns_of("mag_", turned(48_000))))
    assert found.is_certain and found.channel_map.time == "stamp" and "rate_hz" not in found.map_yaml()
    only(found.oddities, "without a time, rows count as 1 s apart")


def test_a_damaged_topic_does_not_hide_the_others(tmp_path):
    """What cannot be read of one topic is told there, and the others are read."""
    bag = {"/mag": (fields(turned(), times()), times()), "/cut": (numbers(np.arange(COUNT)), times())}
    path = write_bag(tmp_path / "bag", bag) / "bag.mcap"
    found = inspect(path)
    assert found.is_certain
    read = oddities._parts

    def broken(source, wanted, progress):
        if any(each.table.name == "/cut" for each in wanted.values()):
            raise InputError("topic /cut: a message is shorter than its type says")
        return read(source, wanted, progress)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(oddities, "_parts", broken)
        found = inspect(path)
    assert found.is_certain and "/cut: topic /cut: a message is shorter" in found.oddities[0]


@pytest.mark.parametrize(
    "content", [b"", b"\0\1\2\3" * 300, b"hello\nworld\n", b"\x89MCAP0\r\n" + bytes(90), b"PAR1" * 9]
)
@pytest.mark.parametrize("name", ["run.csv", "run.mcap", "run.db3"])
def test_rubbish_is_one_sentence(tmp_path, content, name):
    """Whatever the name of the file."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError) as told:
        inspect(tmp_path / name)
    assert "\n" not in str(told.value) and name in str(told.value) and len(str(told.value)) < 400


def test_files_that_are_no_one_recording_are_refused(tmp_path):
    """A bag among them, one in another folder, and one twice."""
    first = text(tmp_path)
    (tmp_path / "other").mkdir()
    bag = write_bag(tmp_path / "bag", {"/mag": (fields(turned(), times()), times())})
    for files, words in (
        ([first, bag], "only where each is a table of rows"),
        ([first, text(tmp_path / "other")], "lies in another folder"),
        ([first, first], "a file is given twice"),
    ):
        with pytest.raises(InputError, match=words):
            inspect(files)


def test_the_reader_of_the_documentation_works(tmp_path, monkeypatch):
    """An installed package that offers it under the entry point group makes its files readable."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "how_to" / "add_reader.md").read_text(), re.DOTALL)
    (tmp_path / "lab.py").write_text(code)
    installed = tmp_path / "lab-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: lab\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(f"[{recording_file.GROUP}]\nlab = lab:LabReader\n")
    rows = np.column_stack([times(first_ns=0) / 1e9, turned(48_000)])
    (tmp_path / "run.lab").write_bytes(b"LAB1" + rows.tobytes())
    monkeypatch.syspath_prepend(tmp_path)
    recording_file._readers.cache_clear()
    found = inspect(tmp_path / "run.lab")
    recording_file._readers.cache_clear()
    assert found.is_certain and found.format == "LAB1 file" and found.channel_map.sensors[0].topic == "magnetometer"
    np.testing.assert_allclose(read_recording(tmp_path / "run.lab").readings_T[:, 0], turned(48_000) * 1e-9)


def test_a_reader_that_cannot_be_loaded_costs_only_itself(tmp_path, monkeypatch, caplog):
    """It is named in a warning, and all other formats are read."""
    broken = EntryPoint("lab", "no_such_package.lab:LabReader", recording_file.GROUP)
    monkeypatch.setattr(recording_file, "entry_points", lambda group: [*entry_points(group=group), broken])
    recording_file._readers.cache_clear()
    try:
        assert inspect(text(tmp_path)).is_certain
        assert read_recording(write_bag(tmp_path / "bag", {"/mag": (fields(turned(), times()), times())})).sample_count
    finally:
        recording_file._readers.cache_clear()
    (told,) = caplog.messages[:1]
    assert told.startswith("the reader lab of no_such_package.lab:LabReader cannot be loaded (No module named")


def test_several_connections_of_a_topic_are_told():
    """As bags of ROS 1 have them, one for each publisher."""
    table = Table("/mag", ("x", "y", "z"), publishers=2)
    assert of_times(Series(table, table.fields, turned(), times())) == ["2 publishers wrote to it"]
