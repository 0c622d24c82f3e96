"""What is taken for what: sensors in their order, channels by type and name, and what is ambiguous."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from inspected import COUNT, fields, numbers, times, turned, write_bag

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.recordings import read_recording
from tam_calibration.recordings.channel_map import Pick, map_of
from tam_calibration.recordings.choice import choose, resolve
from tam_calibration.recordings.tables import Table
from tam_calibration.recordings.vectors import is_own_column

MAGNETIC_FIELD, IMU, TEMPERATURE = (f"sensor_msgs/msg/{name}" for name in ("MagneticField", "Imu", "Temperature"))
FIELD = tuple(f"magnetic_field.{axis}" for axis in "xyz")
ORIENTATION = tuple(f"orientation.{axis}" for axis in "xyzw")
RATES = tuple(f"angular_velocity.{axis}" for axis in "xyz")


@dataclass
class Held:
    """A source that holds tables, and nothing to read."""

    tables: list[Table]
    path: Path = Path("run")
    format: str = "bag"
    unfinished: str = ""


def topics(*names, kind=MAGNETIC_FIELD, paths=FIELD, frames=()):
    """Return tables of topics of one type."""
    frames = frames or [()] * len(names)
    return [Table(name, paths, kind, frames=frame) for name, frame in zip(names, frames, strict=True)]


def rows(*names):
    """Return the table of a text file."""
    return Held([Table("", tuple(name for name in names if name != "time_s"), columns=names)])


def vector(*names, axes="xyz"):
    """Return the columns of vectors, ``*`` for the axis."""
    return [name.replace("*", axis) for name in names for axis in axes]


def chosen(tables, count=None, frame_ids=None):
    """Return the map that is chosen without a doubt."""
    choice = choose(tables if isinstance(tables, Held) else Held(tables), count, frame_ids)
    assert not choice.doubts, choice.doubts
    return choice.channel_map


def doubt(tables, count=None):
    """Return the only doubt."""
    (told,) = choose(tables if isinstance(tables, Held) else Held(tables), count).doubts
    return told


@settings(deadline=None, max_examples=30)
@given(st.permutations([1, 2, 3, 9, 10, 11, 100]))
def test_sensors_are_ordered_by_their_numbers(order):
    """10 comes behind 9, wherever the number stands, in topics, instances and columns."""
    numbers = sorted(order)
    topic = chosen(topics(*(f"/mag{number}/data" for number in order)))
    assert [pick.topic for pick in topic.sensors] == [f"/mag{number}/data" for number in numbers]
    logs = [Table("sensor_mag", ("x", "y", "z"), instance=number) for number in order]
    assert [pick.instance for pick in chosen(logs).sensors] == numbers
    text = chosen(rows("time_s", *vector(*(f"mag*_{number}" for number in order))))
    assert [pick.columns[0] for pick in text.sensors] == [f"magx_{number}" for number in numbers]


def test_sensors_without_numbers_are_ordered_by_the_alphabet():
    """By their whole names; as that is a guess, it is said, unless frames tell the order."""
    names = ["/port/mag", "/bow/mag", "/starboard/mag", "/aft/mag"]
    assert [pick.topic for pick in chosen(topics(*names)).sensors] == sorted(names)
    (told,) = choose(Held(topics(*names)), None).remarks
    assert told == (
        "sensors 1 to 4 are aft, bow, port, starboard in alphabetical order, as no number in their names tells: "
        "confirm it with a map or frame_ids"
    )
    framed = topics(*names, frames=[(name,) for name in names])
    assert not choose(Held(framed), None, names).remarks


@pytest.mark.parametrize(
    ("patterns", "is_told"),
    [
        (["front_b*", "left_b*"], False),
        (["mag1_rear_*", "mag1_front_*"], False),
        (["front_1_b*", "left_2_b*"], True),
        (["left_1_b*", "front_2_b*"], False),
        (["mag1_rear_*", "mag2_front_*"], True),
        (["MagA_*", "MagB_*"], True),
        (["mag*"], True),
    ],
)
def test_numbers_and_letters_tell_an_order(patterns, is_told):
    """Where they rise in the order that is taken; other names do not, although they have one in the alphabet."""
    choice = choose(rows("time_s", *vector(*patterns)), len(patterns))
    assert (choice.order == "") == is_told and choice.remarks == tuple(filter(None, [choice.order]))


def test_frames_settle_the_order():
    """Where each frame of the array is that of one topic; else the names count."""
    tables = topics("/mag0", "/mag1", "/mag2", frames=[("c",), ("a",), ("b",)])
    assert [pick.topic for pick in chosen(tables, 3, ("a", "b", "c")).sensors] == ["/mag1", "/mag2", "/mag0"]
    for frame_ids in (("a", "b", "d"), None):
        assert [pick.topic for pick in chosen(tables, 3, frame_ids).sensors] == ["/mag0", "/mag1", "/mag2"]
    both = topics("/raw0", "/raw1", "/clean0", "/clean1", frames=[("a",), ("b",), ("c",), ("d",)])
    assert [pick.topic for pick in chosen(both, 2, ("d", "c")).sensors] == ["/clean1", "/clean0"]


def test_a_recording_is_read_in_the_order_of_the_frames(tmp_path):
    """An array file with frames orders the sensors of every command, not only of the inspection."""
    readings = {topic: turned(sensor=sensor) for sensor, topic in enumerate(("/mag0", "/mag1"))}
    bag = {topic: (fields(each, times(), f"{topic[1:]}_link"), times()) for topic, each in readings.items()}
    path = write_bag(tmp_path / "bag", bag)
    mounting = Mounting(frame_ids=("mag1_link", "mag0_link"))
    array = Array(np.array([[0.25, 0, 0], [-0.25, 0, 0]]), mounting=mounting)
    np.testing.assert_array_equal(read_recording(path, array=array).readings_T[:, 0], readings["/mag1"])
    np.testing.assert_array_equal(read_recording(path).readings_T[:, 0], readings["/mag0"])


def test_raw_readings_are_taken_before_filtered_ones():
    """What is left out is told; the filtered ones are taken where only their number is the array's."""
    two = topics("/raw/mag0", "/raw/mag1", "/filtered/mag0", "/filtered/mag1")
    found = choose(Held(two), None)
    assert [pick.topic for pick in found.channel_map.sensors] == ["/raw/mag0", "/raw/mag1"] and not found.doubts
    assert "not taken" in found.remarks[0] and "/filtered/mag0, /filtered/mag1" in found.remarks[0]
    three = [*two, *topics("/raw/mag2")]
    assert [pick.topic for pick in chosen(three, 2).sensors] == ["/filtered/mag0", "/filtered/mag1"]
    assert [pick.topic for pick in chosen(three).sensors] == ["/raw/mag0", "/raw/mag1", "/raw/mag2"]


def test_two_sets_of_sensors_are_ambiguous():
    """They are listed, and naming one in a map settles it."""
    two = topics("/bow/mag0", "/bow/mag1", "/aft/mag0", "/aft/mag1")
    for count in (None, 2):
        assert doubt(two, count).startswith("several sets of sensors may be meant (/aft/mag0, /aft/mag1, /bow/mag0, ")
        assert doubt(two, count).endswith("/bow/mag1): name one in the map")


def test_another_number_of_sensors_is_told():
    """With what there is."""
    told = doubt(topics("/a/mag", "/b/mag"), 4)
    assert (
        told
        == "2 magnetic vectors are there (/a/mag, /b/mag), and the array has 4 sensors: name the sensors in the map"
    )


@pytest.mark.parametrize(
    "names",
    [
        ("mag_*",),
        ("Mag1_*", "Mag2_*"),
        ("B1*", "B2*"),
        ("b_*",),
        ("H*",),
        ("compass.*",),
        ("Fluxgate * [nT]",),
        ("MagneticField*",),
        ("tam1_*", "tam2_*"),
    ],
)
def test_names_of_a_magnetic_field(names):
    """Beside accelerations, rates, biases and offsets, which are no readings of it."""
    others = vector("acc_*", "gyro_*", "mag_bias_*", "vel*", "MagOfs*")
    found = chosen(rows("time_s", *others, *vector(*names)))
    assert [pick.columns for pick in found.sensors] == [vector(name) for name in names]


@pytest.mark.parametrize(
    ("suffix", "unit"),
    [("_nT", "nT"), (" [µT]", "uT"), ("(uT)", "uT"), (" (mG)", "mG"), ("_gauss", "G"), ("_T", "T"), ("", "")],
)
def test_a_unit_behind_a_name_is_taken(suffix, unit):
    """Of sensors and of the scalar."""
    found = chosen(rows("time_s", *vector(f"mag*{suffix}"), f"total{suffix}"))
    assert found.sensors[0].unit == found.scalar.unit == unit


@pytest.mark.parametrize(
    ("name", "is_scalar"),
    [*((name, True) for name in ("F", "scalar", "Overhauser", "total_field", "Btot", "intensity", "Cs absolute")),
     *((name, True) for name in ("Ftot (nT)", "TMI (nT)", "|B| nT", "MagF (nT)", "Cs1", "tmi_nT")),
     *((name, False) for name in ("speed", "frame", "flag", "height", "MagFlag", "csv", "CO2_ppm"))],
)  # fmt: skip
def test_names_of_a_scalar(name, is_scalar):
    """A single number of such a name."""
    found = chosen(rows("time_s", *vector("mag_*"), name))
    assert (found.scalar is not None and found.scalar.column == name) == is_scalar


def test_what_may_be_a_scalar_is_named():
    """Another number in a unit of a field, and a topic of such an instrument; where a scalar is taken, none is."""
    for table in (rows("time_s", *vector("mag_*"), "ppm_nT", "speed"), rows("time_s", *vector("mag_*"), "ppm_nT", "F")):
        named = ("not taken, may be a scalar: ppm_nT",) if "F" not in table.tables[0].fields else ()
        assert choose(table, 1).remarks == named
    ranged = Table("/overhauser/total_field", ("field_of_view", "min_range", "range"), "sensor_msgs/msg/Range")
    assert choose(Held([*topics("/mag"), ranged]), 1).remarks == (
        "not taken, may be a scalar: /overhauser/total_field",
    )


def test_a_scalar_topic_and_a_list_with_one_number_more():
    """By the topic's name, and by the place behind the vectors."""
    scalar = Table("/overhauser", ("data",), "std_msgs/msg/Float64")
    assert chosen([*topics("/mag"), scalar]).scalar == Pick(topic="/overhauser", field="data")
    listed = [Table("/adc", tuple(f"data[{place}]" for place in range(13)), "std_msgs/msg/Float64MultiArray")]
    found = chosen(listed, 4)
    assert [pick.fields[0] for pick in found.sensors] == ["data[0]", "data[3]", "data[6]", "data[9]"]
    assert found.scalar == Pick(topic="/adc", field="data[12]")
    assert doubt(listed).endswith("name the sensors in a map, or give --array")


def test_columns_without_names_are_taken_in_their_order():
    """Three for each sensor of the array, then the scalar, behind the time."""
    columns = tuple(map(str, range(1, 9)))
    table = Table("", columns[1:], columns=columns)
    found = chosen(Held([table]), 2)
    assert [pick.columns for pick in found.sensors] == [[2, 3, 4], [5, 6, 7]] and found.scalar == Pick(column=8)
    assert doubt(Held([table])).startswith("no name or type says")


def test_channels_beside_the_sensors():
    """An IMU's orientation and rates, a temperature by its type, a current by its name."""
    tables = [
        *topics("/mag0", "/mag1"),
        Table("/imu", (*ORIENTATION, *RATES, *(f"linear_acceleration.{axis}" for axis in "xyz")), IMU),
        Table("/mag0/temperature", ("temperature", "variance"), TEMPERATURE),
        Table("/battery", ("voltage", "current", "charge"), "sensor_msgs/msg/BatteryState"),
    ]
    found = chosen(tables)
    assert found.attitude == Pick(topic="/imu", field="orientation")
    assert found.gyroscope == Pick(topic="/imu", field="angular_velocity")
    assert found.temperature == Pick(topic="/mag0/temperature")
    assert found.current == Pick(topic="/battery", field="current")
    assert found.scalar is None
    wanted = resolve(Held(tables), found).wanted
    assert wanted["attitude"].fields == ORIENTATION and wanted["tam_2"].fields == FIELD
    assert wanted["temperature"].fields == ("temperature",)


def test_channels_among_columns():
    """A quaternion of any spelling, a temperature, a current."""
    found = chosen(rows("time_s", *vector("mag_*"), *vector("Q*", axes="wxyz"), "Temp (°C)", "I current", "gyro_x"))
    assert found.attitude == Pick(columns=vector("Q*", axes="xyzw"))
    assert found.temperature == Pick(column="Temp (°C)") and found.current == Pick(column="I current")


def test_several_of_a_channel_are_remarked_and_none_is_taken():
    """Unless one of them is in the sensor's own table."""
    imus = [Table(name, (*ORIENTATION, *RATES), IMU) for name in ("/imu0", "/imu1")]
    choice = choose(Held([*topics("/mag"), *imus]), None)
    assert not choice.doubts and choice.channel_map.attitude is None
    assert choice.remarks[0] == "the attitude may be /imu0 orientation or /imu1 orientation: name one in the map"
    own = Table("/own", (*FIELD, "temperature"), "lab/msg/Reading")
    other = Table("/board", ("temperature",), TEMPERATURE)
    assert chosen([own, other]).temperature == Pick(topic="/own", field="temperature")


def test_nothing_magnetic_lists_what_there_is():
    """Topics with their types, columns by their names."""
    tables = topics("/odom", kind="nav_msgs/msg/Odometry", paths=("pose.x",))
    assert doubt(tables) == "no vector of a magnetic field is recognised among /odom (nav_msgs/msg/Odometry)"
    assert doubt(rows("time_s", "speed")) == "no vector of a magnetic field is recognised among columns speed"
    assert doubt(Held([])) == "no vector of a magnetic field is recognised among nothing"


OWN = ["time_s", *vector("b1*_nT", "b2*_nT"), "scalar_nT", "temperature_C", "current_A", "qx", "qy", "qz", "qw"]


def test_columns_of_this_package_are_its_own():
    """In any order, with the further channels, and nothing is said of the choice."""
    source = rows(*OWN[::-1], "current_2_A", "wx_rad_s", "wy_rad_s", "wz_rad_s")
    found = chosen(source)
    assert [pick.columns for pick in found.sensors] == [vector("b1*_nT"), vector("b2*_nT")]
    assert all(pick.unit == "nT" for pick in (*found.sensors, found.scalar))
    assert found.attitude.columns == ["qx", "qy", "qz", "qw"] and set(found.further) == {"current_2_A"}
    assert found.gyroscope.columns == vector("w*_rad_s")
    assert all(map(is_own_column, OWN)) and choose(rows(*OWN), None).is_own


def test_columns_that_are_not_read_are_told():
    """Those beside our own, which need no map."""
    source = rows(*OWN, "speed", "notes")
    assert choose(source, None).remarks == ("not read: speed, notes",)


@pytest.mark.parametrize(
    ("left_out", "added", "sentence"),
    [
        ("b2y_nT", (), r"column b2y_nT is missing \(of 2 sensors\)"),
        ("qz", (), "column qz is missing"),
        ("b2y_nT", ("b2y_uT",), "the columns of sensor 2 are in nT and uT: give them one unit"),
        ("", vector("b99*_nT"), "sensors"),
    ],
)
def test_a_column_of_ours_that_is_missing_is_named(left_out, added, sentence):
    """It is no reason to take something else."""
    with pytest.raises(InputError, match=sentence):
        choose(rows(*(name for name in OWN if name != left_out), *added), None)


def test_topics_of_this_package_are_its_own():
    """With or without a namespace, whatever else there is; of several arrays none is taken."""
    for space in ("/", "/auv/"):
        own = topics(f"{space}tam_1/magnetic_field", f"{space}tam_2/magnetic_field")
        scalar = Table(f"{space}scalar/intensity", ("data",), "std_msgs/msg/Float64")
        source = Held([*topics("/mag0", "/mag1", "/mag2"), *own, scalar])
        found = chosen(source)
        assert [pick.topic for pick in found.sensors] == [table.name for table in own]
        assert found.scalar == Pick(topic=scalar.name) and choose(source, None).is_own
    two = topics("/a/tam_1/magnetic_field", "/b/tam_1/magnetic_field")
    with pytest.raises(InputError, match="several arrays, under /a/, /b/: name the topics of one in a map"):
        choose(Held(two), None)
    with pytest.raises(InputError, match="the bag has 2 sensors, the array 1: use the array file of this bag"):
        choose(Held(own), 1)


@pytest.mark.parametrize(
    ("sensor", "fields_of"),
    [
        ({"topic": "/mag"}, FIELD),
        ({"topic": "mag"}, FIELD),
        ({"topic": "/mag", "field": "magnetic_field"}, FIELD),
        ({"topic": "/mag", "fields": [FIELD[2], FIELD[0], FIELD[1]]}, (FIELD[2], FIELD[0], FIELD[1])),
        ({"topic": "/adc", "field": "vec"}, ("vec[0]", "vec[1]", "vec[2]")),
        ({"topic": "/custom"}, ("mag.x", "mag.y", "mag.z")),
    ],
)
def test_what_a_map_names_is_found(sensor, fields_of):
    """By topic, with or without its slash; fields by the type, a vector's path, a short list, or one by one."""
    tables = [
        *topics("/mag"),
        Table("/adc", ("vec[0]", "vec[1]", "vec[2]")),
        Table("/custom", (*(f"mag.{axis}" for axis in "xyz"), *(f"acc.{axis}" for axis in "xyz"))),
    ]
    assert resolve(Held(tables), map_of({"sensors": [sensor]})).wanted["tam_1"].fields == fields_of


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({"topic": "/mat"}, r"topic /mat is missing; the recording has /f, /mag, /two"),
        ({"topic": "/mag", "instance": 2}, r"topic /mag \[2\] is missing"),
        ({"topic": "/mag", "field": "field"}, "/mag has no field: it has magnetic_field.x"),
        (
            {"topic": "/mag", "fields": ["magnetic_field.x"] * 2},
            "sensor 1 needs 3 numbers of /mag, and the map names 2",
        ),
        ({"topic": "/f"}, "sensor 1 needs 3 numbers of /f, and the map names 1|does not say which"),
        ({"topic": "/two"}, "/two is a table, and the map does not say which of its fields is sensor 1: it has a.x"),
        ({"topic": "/mag", "columns": [1, 2, 9]}, "/mag has 0 columns, none with the number 1"),
    ],
)
def test_what_a_map_names_and_is_not_there_is_told(keys, sentence):
    """With what there is instead."""
    tables = [*topics("/mag"), Table("/f", ("data",)), Table("/two", tuple(vector("a.*", "b.*")))]
    with pytest.raises(InputError, match=sentence):
        resolve(Held(tables), map_of({"sensors": [keys]}))


def test_messages_without_stamps_have_the_times_of_the_recorder():
    """Where a sensor is not stamped; a scalar alone is held."""
    stamped, bare = Table("/a", FIELD), Table("/b", FIELD, is_stamped=False)
    scalar = Table("/f", ("data",), is_stamped=False)
    both = {"sensors": [{"topic": "/a", "field": "magnetic_field"}], "scalar": {"topic": "/f"}}
    streams = resolve(Held([stamped, bare, scalar]), map_of(both))
    assert streams.clock == "stamp" and streams.scalar_is_held
    both["sensors"].append({"topic": "/b", "field": "magnetic_field"})
    streams = resolve(Held([stamped, bare, scalar]), map_of(both))
    assert streams.clock == "received" and not streams.scalar_is_held


def test_a_scalar_of_any_name_is_read(tmp_path):
    """And nobody has to name it."""
    bag = {"/mag": (fields(turned(), times()), times()), "/proton": (numbers(np.arange(COUNT) + 48_000), times())}
    assert read_recording(write_bag(tmp_path / "bag", bag)).scalar_count == COUNT
