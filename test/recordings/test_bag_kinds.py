"""Whole bags of every kind that recorders and tools write are read, none is called damaged."""

import json
import sqlite3
import struct
from contextlib import closing
from functools import cache

import numpy as np
import pytest
import yaml
from mcap_by_hand import mcap
from numpy.testing import assert_array_equal
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import read_recording, read_samples
from tam_calibration.recordings.bag_reader import open_bag, raw_messages
from tam_calibration.recordings.bag_writing import recover
from tam_calibration.recordings.recording_file import is_bag

ROS2, ROS1 = get_typestore(Stores.ROS2_JAZZY), get_typestore(Stores.ROS1_NOETIC)
FIELD = "sensor_msgs/msg/MagneticField"
TOPICS = ("/tam_1/magnetic_field", "/tam_2/magnetic_field")
START_NS, PERIOD_NS, COUNT = 1_700_000_000_000_000_000, 10_000_000, 30

VECTOR_IDL = "module geometry { module msg { struct Point { double x; double y; double z; }; }; };"


def readings():
    """Return the truth (N, 2, 3), tesla."""
    return 5e-5 * np.random.default_rng(7).normal(size=(COUNT, 2, 3))


def field(store, stamp_ns, reading):
    """Make a MagneticField of ROS 1 or 2."""
    types = store.types
    stamp = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
    sequence = (0,) if store is ROS1 else ()
    header = types["std_msgs/msg/Header"](*sequence, stamp, "sensor")
    return types[FIELD](header, types["geometry_msgs/msg/Vector3"](*reading), np.zeros(9))


def messages(store=ROS2):
    """Return (sensor, recorded_ns, bytes) of all readings."""
    serialise = store.serialize_ros1 if store is ROS1 else store.serialize_cdr
    return [
        (
            sensor,
            START_NS + index * PERIOD_NS,
            bytes(serialise(field(store, START_NS + index * PERIOD_NS, reading), FIELD)),
        )
        for index, pair in enumerate(readings())
        for sensor, reading in enumerate(pair)
    ]


def channels(encoding="ros2msg", serialisation="cdr", name=FIELD):
    """Return the channels of an mcap file laid out by hand."""
    version = 1 if encoding == "ros1msg" else 2
    definition, _ = (ROS1 if version == 1 else ROS2).generate_msgdef(FIELD, ros_version=version)
    return [(topic, name, encoding, definition, serialisation) for topic in TOPICS]


def in_channels(rows):
    """Return messages with the numbers of channels, which begin at 1."""
    return [(number + 1, *rest) for number, *rest in rows]


def write(path, storage=StoragePlugin.SQLITE3, compression=CompressionMode.NONE, version=9, rows=None):
    """Write the readings, or other messages, as a bag by rosbags."""
    writer = Writer(path, version=version, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = [writer.add_connection(topic, FIELD, typestore=ROS2) for topic in TOPICS]
        for number, recorded_ns, message in messages() if rows is None else rows:
            writer.write(connections[number], recorded_ns, message)
    return path


@cache
def store_of(definition):
    """Return what decodes a field by the definition that a bag holds."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(definition, FIELD))
    return store


def read_ros1(path):
    """Return topic, time and field of messages of ROS 1, decoded by rosbags with the definition that the bag holds."""
    found = []
    with open_bag(path) as reader:
        for one, recorded_ns, message in raw_messages(reader, reader.connections):
            assert one.ext.serialization_format == "ros1" and one.msgtype == FIELD
            store = store_of(one.msgdef.data)
            vector = store.deserialize_ros1(message, FIELD).magnetic_field
            found.append((one.topic, recorded_ns, (vector.x, vector.y, vector.z)))
    return found


def expected():
    """Return topic, time and field of all readings."""
    return [
        (topic, START_NS + index * PERIOD_NS, tuple(reading))
        for index, pair in enumerate(readings())
        for topic, reading in zip(TOPICS, pair, strict=True)
    ]


@pytest.mark.parametrize("profile", ["", "ros2", "px4"])
@pytest.mark.parametrize("indexed", [True, False])
def test_an_mcap_file_of_any_profile_is_read(tmp_path, caplog, profile, indexed):
    """The profile is a remark of the recorder; the channels say how messages are serialised."""
    (tmp_path / "run.mcap").write_bytes(mcap(profile, channels(), in_channels(messages()), indexed))
    assert_array_equal(read_recording(tmp_path / "run.mcap").readings_T, readings())
    assert not caplog.text


@pytest.mark.parametrize("indexed", [True, False])
@pytest.mark.parametrize("kind", [("jsonschema", "json"), ("protobuf", "protobuf"), ("", "json")])
def test_a_topic_that_cannot_be_read_is_left_out_with_a_warning(tmp_path, caplog, kind, indexed):
    """It is named with its serialisation; the others are read, and recovered."""
    topics = [*channels(), ("/status", "Status", kind[0], b"\xff{}", kind[1])]
    rows = [*in_channels(messages()), (3, START_NS, json.dumps({"ok": True}).encode())]
    (tmp_path / "run.mcap").write_bytes(mcap("", topics, rows, indexed))
    if indexed:
        assert_array_equal(read_recording(tmp_path / "run.mcap").readings_T, readings())
        assert f"/status is not read: its messages are {kind[1]}" in caplog.text
    found = recover(tmp_path / "run.mcap", tmp_path / "new")
    assert not found.faults and f"1 messages of /status in {kind[1]} are left out" in caplog.text
    assert_array_equal(read_recording(tmp_path / "new").readings_T, readings())


def test_messages_of_ros1_in_mcap_say_so(tmp_path):
    """With the definition that rosbags decodes them by, and the name that ROS 2 gives the type; recovered too."""
    topics = channels("ros1msg", "ros1", "sensor_msgs/MagneticField")
    (tmp_path / "run.mcap").write_bytes(mcap("ros1", topics, in_channels(messages(ROS1))))
    assert read_ros1(tmp_path / "run.mcap") == expected()
    recover(tmp_path / "run.mcap", tmp_path / "new.mcap")
    assert read_ros1(tmp_path / "new.mcap") == expected()


@pytest.mark.parametrize(("encoding", "name"), [("omgidl", "geometry::msg::Point"), ("ros2idl", "geometry/msg/Point")])
def test_definitions_in_idl_are_handed_on(tmp_path, encoding, name):
    """In the form that ROS 2 writes, which rosbags parses; recovered too."""
    data = b"\x00\x01\x00\x00" + struct.pack("<ddd", 1.0, 2.0, 3.0)
    topics = [("/point", name, encoding, VECTOR_IDL, "cdr")]
    (tmp_path / "run.mcap").write_bytes(mcap("", topics, [(1, START_NS, data)]))
    recover(tmp_path / "run.mcap", tmp_path / "new")
    for path in (tmp_path / "run.mcap", tmp_path / "new"):
        with open_bag(path) as reader:
            [(one, _, message)] = raw_messages(reader, reader.connections)
        assert one.msgtype == "geometry/msg/Point" and one.msgdef.format is MessageDefinitionFormat.IDL
        head, _, definition = one.msgdef.data.removeprefix("=" * 80 + "\n").partition("\n")
        store = get_typestore(Stores.EMPTY)
        store.register(get_types_from_idl(definition))
        assert head == "IDL: geometry/msg/Point"
        assert store.deserialize_cdr(message, one.msgtype).y == 2.0


@pytest.mark.parametrize("version", [4, 5, 6, 7, 8, 9])
@pytest.mark.parametrize(
    ("storage", "compression"),
    [
        *((storage, mode) for storage in StoragePlugin for mode in list(CompressionMode)[:3]),
        (StoragePlugin.MCAP, CompressionMode.STORAGE),
    ],
)
def test_metadata_of_every_distribution_are_read(tmp_path, storage, compression, version):
    """From Foxy to Rolling, with the keys that each has; also where `ros2 bag reindex` names no storage."""
    path = write(tmp_path / "bag", storage, compression, version=9 if version == 9 else 8)
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    information = content["rosbag2_bagfile_information"]
    information["version"] = version
    for key, since in {"files": 5, "custom_data": 6, "ros_distro": 8}.items():
        if version < since:
            del information[key]
    if version < 7:
        for each in information["topics_with_message_count"]:
            del each["topic_metadata"]["type_description_hash"]
    if version == 6:  # as Humble reindexes
        information["storage_identifier"] = ""
    information["compression_mode"] = information["compression_mode"].upper()
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert_array_equal(read_recording(path).readings_T, readings())


@pytest.mark.parametrize("schema", [1, 2, 3])
def test_databases_of_every_distribution_are_read(tmp_path, schema):
    """Those of older ones have fewer columns, and no definitions of types."""
    path = write(tmp_path / "bag")
    with closing(sqlite3.connect(path / "bag.db3")) as database, database:
        database.execute("DROP TABLE message_definitions")
        database.execute("ALTER TABLE topics DROP COLUMN type_description_hash")
        if schema < 2:
            database.execute("ALTER TABLE topics DROP COLUMN offered_qos_profiles")
        if schema < 3:
            database.execute("DROP TABLE schema")
    assert_array_equal(read_recording(path).readings_T, readings())
    with open_bag(path) as reader:
        assert {one.msgdef.format for one in reader.connections} == {MessageDefinitionFormat.NONE}


def test_a_database_is_read_whose_index_somebody_dropped(tmp_path, caplog):
    """By SQL, or from the schema alone, which leaves pages that nothing uses: the rows are whole."""
    for name, statements in {
        "sql": ["DROP INDEX timestamp_idx"],
        "schema": ["PRAGMA writable_schema = ON", "DELETE FROM sqlite_master WHERE name = 'timestamp_idx'"],
        "renamed": ["DROP INDEX timestamp_idx", "CREATE INDEX other ON messages (timestamp)"],
        "of another column": ["DROP INDEX timestamp_idx", "CREATE INDEX timestamp_idx ON messages (topic_id)"],
    }.items():
        path = write(tmp_path / name, rows=messages()[::-1])
        with closing(sqlite3.connect(path / f"{name}.db3")) as database, database:
            for statement in statements:
                database.execute(statement)
        assert_array_equal(read_recording(path).readings_T, readings())
    assert not caplog.text


@pytest.mark.parametrize("storage", StoragePlugin)
def test_empty_messages_are_left_out_and_counted(tmp_path, caplog, storage):
    """The others are read; `tam recover` leaves them out too."""
    rows = [(n, time, b"" if index % 10 == 3 else message) for index, (n, time, message) in enumerate(messages())]
    path = write(tmp_path / "bag", storage, rows=rows)
    kept = read_recording(write(tmp_path / "kept", storage, rows=[row for row in rows if row[2]])).readings_T
    lost = len([row for row in rows if not row[2]])
    caplog.clear()
    assert_array_equal(read_recording(path).readings_T, kept)
    assert f"{lost} empty messages of /tam_2/magnetic_field are left out" in caplog.text
    caplog.clear()
    found = recover(path, tmp_path / "new")
    assert found.faults == (f"empty messages of /tam_2/magnetic_field: {lost} left out",)
    assert_array_equal(read_recording(tmp_path / "new").readings_T, kept)
    assert "empty" not in caplog.text


@pytest.mark.parametrize("storage", StoragePlugin)
def test_every_message_three_times_is_read_once(tmp_path, caplog, storage):
    """The repeats reach the synchroniser, which counts them."""
    path = write(tmp_path / "bag", storage, rows=[row for row in messages() for _ in range(3)])
    assert_array_equal(read_samples(path).recording.readings_T, readings())
    assert f"tam_1: {2 * COUNT} repeated stamps" in caplog.text


@pytest.mark.parametrize("storage", StoragePlugin)
def test_of_a_topic_that_changes_its_type_the_most_messages_are_read(tmp_path, caplog, storage):
    """With a warning that names both types and counts."""
    text = ROS2.types["std_msgs/msg/String"]("the driver was updated")
    with Writer(tmp_path / "bag", version=9, storage_plugin=storage) as writer:
        late = writer.add_connection(TOPICS[1], "std_msgs/msg/String", typestore=ROS2)
        connections = [writer.add_connection(topic, FIELD, typestore=ROS2) for topic in TOPICS]
        for number, recorded_ns, message in messages():
            writer.write(connections[number], recorded_ns, message)
        for index in range(2):
            writer.write(late, START_NS + COUNT * PERIOD_NS + index, ROS2.serialize_cdr(text, "std_msgs/msg/String"))
    assert_array_equal(read_recording(tmp_path / "bag").readings_T, readings())
    told = f"2 of std_msgs/msg/String; used: {COUNT} of {FIELD}"
    assert f"{TOPICS[1]} has messages of several types; left out: {told}" in caplog.text


@pytest.mark.parametrize("publishers", [1, 2])
def test_all_publishers_of_a_topic_are_read(tmp_path, publishers):
    """Which in mcap, and in ROS 1, may have a connection each."""
    rows = [(1 + number + 2 * (index % publishers), *rest) for index, (number, *rest) in enumerate(messages())]
    (tmp_path / "run.mcap").write_bytes(mcap("", channels() * publishers, rows))
    assert_array_equal(read_recording(tmp_path / "run.mcap").readings_T, readings())


def write_ros1(path, compression=None):
    """Write the readings as a bag of ROS 1."""
    writer = Ros1Writer(path)
    if compression:
        writer.set_compression(compression)
    with writer:
        connections = [writer.add_connection(topic, FIELD, typestore=ROS1) for topic in TOPICS]
        for number, recorded_ns, message in messages(ROS1):
            writer.write(connections[number], recorded_ns, message)
    return path


@pytest.mark.parametrize(
    ("name", "compression"),
    [("run.bag.active", None), *(("run.bag", each) for each in (None, *Ros1Writer.CompressionFormat))],
)
def test_a_bag_of_ros1_is_read(tmp_path, name, compression):
    """By the same functions as those of ROS 2, in every compression; its connections say that they are of ROS 1."""
    path = write_ros1(tmp_path / name, compression)
    assert is_bag(path)
    assert read_ros1(path) == expected()
    with open_bag(path) as reader:
        assert reader.message_count == 2 * COUNT and reader.start_time == START_NS
        assert reader.duration == (COUNT - 1) * PERIOD_NS
        assert [one.msgcount for one in reader.connections] == [COUNT, COUNT]
        [first] = [one for one in reader.connections if one.topic == TOPICS[1]]
        assert [message for _, _, message in raw_messages(reader, [first])] == [
            message for number, _, message in messages(ROS1) if number
        ]


def test_a_bag_of_ros1_without_index_is_told_how_to_mend(tmp_path):
    """By the tool of ROS 1; `tam recover` says the same."""
    path = write_ros1(tmp_path / "run.bag")
    content = path.read_bytes()
    place = content.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(content[:place] + bytes(8) + content[place + 8 :])
    for attempt in (lambda: open_bag(path).__enter__(), lambda: recover(path, tmp_path / "new")):
        with pytest.raises(InputError, match=r"run.bag cannot be read: .*`rosbag reindex run.bag` repairs"):
            attempt()
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize("lost", [1, 13, 200, 4096, 4200])
def test_a_bag_of_ros1_without_its_beginning_is_one_sentence(tmp_path, lost):
    """In which no library of Python speaks."""
    path = write_ros1(tmp_path / "run.bag")
    path.write_bytes(path.read_bytes()[lost:])
    with pytest.raises(InputError, match=r"run.bag cannot be read: .*`rosbag reindex run.bag` repairs") as problem:
        open_bag(path).__enter__()
    assert "codec" not in str(problem.value)


def test_any_cut_of_a_bag_of_ros1_is_one_sentence(tmp_path):
    """Or the messages that are whole; never anything else."""
    content = write_ros1(tmp_path / "run.bag").read_bytes()
    for place in range(20, len(content), 997):
        (tmp_path / "cut.bag").write_bytes(content[:place])
        with pytest.raises(InputError, match=r"cut.bag (cannot be read|is damaged)"), open_bag(tmp_path / "cut.bag"):
            pass
