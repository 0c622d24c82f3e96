"""Eight bags as strangers record them: other topics, types, units, clocks and storages."""

import heapq
import json
import sqlite3
import struct

import numpy as np
from foreign.record import DIRECT, INSPECTED, MAPPED, Foreign
from foreign.truth import STAGGERED, START_S
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROS2 = get_typestore(Stores.ROS2_FOXY)
OWN = get_typestore(Stores.ROS2_JAZZY)
OWN.register(
    get_types_from_msg(
        "std_msgs/Header header\nstring name\ngeometry_msgs/Vector3 mag\nfloat32 temperature", "my_msgs/msg/Tam"
    )
)

TRANSPORT_NS = 1_300_000
"""Time from the stamp of a message to its arrival at the recorder, ns."""


def nanoseconds(time_s):
    """Return Unix times, ns, of seconds since the start."""
    return (round(1e9 * START_S) + np.round(1e9 * np.asarray(time_s))).astype(int)


def header(stamp_ns, frame="", store=ROS2):
    """Return a header."""
    stamp = store.types["builtin_interfaces/msg/Time"](*divmod(int(stamp_ns), 10**9))
    return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame)


def vector(values, store=ROS2):
    """Return a vector message."""
    return store.types["geometry_msgs/msg/Vector3"](*map(float, values))


def simple(kind, received_ns, values):
    """Return type and messages of one number each, without stamp."""
    name = f"std_msgs/msg/{kind}"
    return name, [(time, ROS2.types[name](float(value))) for time, value in zip(received_ns, values, strict=True)]


def magnetic(time_s, readings, frame="", is_stamped=True):
    """Return type and messages of a driver that publishes ``sensor_msgs/MagneticField``."""
    name = "sensor_msgs/msg/MagneticField"
    messages = []
    for stamp, reading in zip(nanoseconds(time_s), readings, strict=True):
        head = header(stamp if is_stamped else 0, frame)
        messages.append((stamp + TRANSPORT_NS, ROS2.types[name](head, vector(reading), np.zeros(9))))
    return name, messages


def drivers(truth, topics, factor=1.0, is_stamped=True):
    """Return the topics of one driver a sensor, in the order of their names; readings are tesla times a factor."""
    return {
        topic: magnetic(
            truth.sensor_time_s[:, sensor],
            factor * truth.readings_T[:, sensor],
            topic.split("/")[1],
            is_stamped,
        )
        for sensor, topic in enumerate(topics)
    }


def in_order(topics):
    """Yield time of recording, topic and message in the order of time."""
    streams = [[(time, topic, message) for time, message in messages] for topic, (_, messages) in topics.items()]
    yield from heapq.merge(*streams, key=lambda each: each[0])


def write_bag(path, topics, storage=StoragePlugin.SQLITE3, store=ROS2):
    """Write a rosbag2 folder as Iron and later do."""
    with Writer(path, version=8, storage_plugin=storage) as writer:
        opened = {topic: writer.add_connection(topic, kind, typestore=store) for topic, (kind, _) in topics.items()}
        for time, topic, message in in_order(topics):
            writer.write(opened[topic], int(time), store.serialize_cdr(message, topics[topic][0]))


def write_foxy_bag(path, topics):
    """Write a rosbag2 folder as Foxy does: metadata version 4, SQLite, without the definitions of messages."""
    path.mkdir()
    with sqlite3.connect(path / f"{path.name}_0.db3") as database:
        database.executescript(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,"
            " serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL);"
            "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL,"
            " timestamp INTEGER NOT NULL, data BLOB NOT NULL); CREATE INDEX timestamp_idx ON messages (timestamp ASC);"
        )
        numbers = {topic: number for number, topic in enumerate(topics, start=1)}
        for topic, (kind, _) in topics.items():
            database.execute("INSERT INTO topics VALUES(?, ?, ?, 'cdr', '')", (numbers[topic], topic, kind))
        rows = [
            (numbers[topic], int(time), bytes(ROS2.serialize_cdr(message, topics[topic][0])))
            for time, topic, message in in_order(topics)
        ]
        database.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES(?, ?, ?)", rows)
    database.close()
    listed = "".join(
        f"    - topic_metadata:\n        name: {topic}\n        type: {kind}\n        serialization_format: cdr\n"
        f'        offered_qos_profiles: ""\n      message_count: {len(messages)}\n'
        for topic, (kind, messages) in topics.items()
    )
    (path / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 4\n  storage_identifier: sqlite3\n"
        f"  relative_file_paths:\n    - {path.name}_0.db3\n  duration:\n    nanoseconds: {rows[-1][1] - rows[0][1]}\n"
        f"  starting_time:\n    nanoseconds_since_epoch: {rows[0][1]}\n  message_count: {len(rows)}\n"
        f'  topics_with_message_count:\n{listed}  compression_format: ""\n  compression_mode: ""\n'
    )


def drivers_of_a_robot(path, truth):
    """Write one MagneticField topic a sensor and an unstamped scalar, tesla, among topics of other kinds."""
    stamps = nanoseconds(truth.time_s)
    twist = ROS2.types["geometry_msgs/msg/Twist"](vector([0.4, 0, 0]), vector([0, 0, 0.1]))
    temperature = ROS2.types["sensor_msgs/msg/Temperature"]
    warmth = [(time, temperature(header(time), 22 + 1e-3 * number, 0.0)) for number, time in enumerate(stamps)]
    topics = drivers(truth, [f"/mag{number}" for number in range(4)]) | {
        "/scalar": simple("Float32", stamps + TRANSPORT_NS, truth.scalar_T),
        "/cmd_vel": ("geometry_msgs/msg/Twist", [(time, twist) for time in stamps]),
        "/board/temperature": ("sensor_msgs/msg/Temperature", warmth),
    }
    write_bag(path, topics)


def vectors_and_slow_scalar(path, truth):
    """Write Vector3Stamped topics in nT, read one after the other, and an unstamped scalar at a fifth of their rate."""
    name = "geometry_msgs/msg/Vector3Stamped"
    topics = {}
    for sensor, letter in enumerate("ABCD"):
        stamps = nanoseconds(truth.sensor_time_s[:, sensor])
        messages = [
            (stamp + TRANSPORT_NS, ROS2.types[name](header(stamp, f"mag{letter}"), vector(1e9 * reading)))
            for stamp, reading in zip(stamps, truth.readings_T[:, sensor], strict=True)
        ]
        topics[f"/sensors/mag{letter}"] = name, messages
    slow = slice(None, None, 5)
    received = nanoseconds(truth.time_s)[slow] + TRANSPORT_NS
    topics["/sensors/overhauser"] = simple("Float64", received, 1e9 * truth.scalar_T[slow])
    write_bag(path, topics, StoragePlugin.MCAP)


def own_message(path, truth):
    """Write messages of an own type with a vector in µT, one topic a sensor, whose order the frames settle."""
    tam = OWN.types["my_msgs/msg/Tam"]
    topics = {}
    stamps = nanoseconds(truth.time_s)
    for sensor, place in enumerate(["front", "left", "back", "right"]):
        messages = [
            (stamp + TRANSPORT_NS, tam(header(stamp, f"tam_{place}", OWN), place, vector(1e6 * reading, OWN), 21.5))
            for stamp, reading in zip(stamps, truth.readings_T[:, sensor], strict=True)
        ]
        topics[f"/array/{place}"] = "my_msgs/msg/Tam", messages
    topics["/array/potassium"] = simple("Float64", stamps + TRANSPORT_NS, 1e6 * truth.scalar_T)
    write_bag(path, topics, store=OWN)


def thirteen_numbers(path, truth):
    """Write all readings as one unstamped array of numbers, nT."""
    name = "std_msgs/msg/Float64MultiArray"
    layout = ROS2.types["std_msgs/msg/MultiArrayLayout"]([], 0)
    received = nanoseconds(truth.time_s) + TRANSPORT_NS
    rows = [(time, ROS2.types[name](layout, row)) for time, row in zip(received, truth.table_nT, strict=True)]
    write_bag(path, {"/adc": (name, rows)}, StoragePlugin.MCAP)


def gauss_by_strange_names(path, truth):
    """Write MagneticField messages in gauss, as a Foxy bag of drivers that nobody numbered."""
    topics = drivers(truth, ["/aft/compass", "/bow/compass", "/port/compass", "/starboard/compass"], factor=1e4)
    topics["/proton/total_field"] = simple("Float64", nanoseconds(truth.time_s) + TRANSPORT_NS, 1e9 * truth.scalar_T)
    write_foxy_bag(path, topics)


def zero_stamps(path, truth):
    """Write MagneticField messages whose stamps are all zero; the recorder's times are sound."""
    topics = drivers(truth, [f"/mag_{number}" for number in (1, 2, 3, 4)], is_stamped=False)
    topics["/total"] = simple("Float64", nanoseconds(truth.time_s) + TRANSPORT_NS, truth.scalar_T)
    write_bag(path, topics)


def ros1(path, truth):
    """Write a bag of ROS 1."""
    store = get_typestore(Stores.ROS1_NOETIC)
    topics = drivers(truth, [f"/fluxgate_{number}/raw" for number in (1, 2, 3, 4)])
    topics["/cesium"] = simple("Float64", nanoseconds(truth.time_s) + TRANSPORT_NS, 1e9 * truth.scalar_T)
    old_header = store.types["std_msgs/msg/Header"]
    with Ros1Writer(path) as writer:
        opened = {topic: writer.add_connection(topic, kind, typestore=store) for topic, (kind, _) in topics.items()}
        for number, (time, topic, message) in enumerate(in_order(topics)):
            kind = topics[topic][0]
            if hasattr(message, "header"):
                head = old_header(number, message.header.stamp, message.header.frame_id)
                message = store.types[kind](head, message.magnetic_field, message.magnetic_field_covariance)
            writer.write(opened[topic], int(time), store.serialize_ros1(message, kind))


def json_beside(path, truth):
    """Write one MCAP file without a profile, with a topic in JSON, by no recorder of ROS."""
    topics = drivers(truth, [f"/mag{number}/field" for number in range(4)])
    topics["/scalar"] = simple("Float64", nanoseconds(truth.time_s) + TRANSPORT_NS, truth.scalar_T)
    kinds = list(dict.fromkeys(kind for kind, _ in topics.values()))
    schemas = {"status": (1, "jsonschema", b'{"type": "object"}')}
    for number, kind in enumerate(kinds, start=2):
        schemas[kind] = number, "ros2msg", ROS2.generate_msgdef(kind, ros_version=2)[0].encode()
    channels = {"/status": (1, "json", "status")}
    for number, (topic, (kind, _)) in enumerate(topics.items(), start=2):
        channels[topic] = number, "cdr", kind
    described = b"".join(
        record(3, struct.pack("<H", number) + text(kind) + text(encoding) + counted(data))
        for kind, (number, encoding, data) in schemas.items()
    ) + b"".join(
        record(4, struct.pack("<HH", number, schemas[kind][0]) + text(topic) + text(encoding) + counted(b""))
        for topic, (number, encoding, kind) in channels.items()
    )
    messages = []
    for time, topic, message in in_order(topics):
        messages.append((time, channels[topic][0], bytes(ROS2.serialize_cdr(message, topics[topic][0]))))
        if topic == "/scalar":
            messages.append((time, 1, json.dumps({"battery": 12.1, "note": "ok"}).encode()))
    first, last, counts = messages[0][0], messages[-1][0], np.bincount([number for _, number, _ in messages])
    body = b"\x89MCAP0\r\n" + record(1, text("") + text("a logger in C"))
    body += described + b"".join(
        record(5, struct.pack("<HIQQ", number, sequence, time, time) + data)
        for sequence, (time, number, data) in enumerate(messages)
    )
    body += record(15, bytes(4))
    by_channel = b"".join(struct.pack("<HQ", number, counts[number]) for number, _, _ in channels.values())
    sizes = len(messages), len(schemas), len(channels), 0, 0, 0, first, last
    statistics = record(11, struct.pack("<QHIIIIQQ", *sizes) + counted(by_channel))
    footer = record(2, struct.pack("<QQI", len(body), 0, 0))
    path.write_bytes(body + described + statistics + footer + b"\x89MCAP0\r\n")


def record(opcode, content):
    """Return a record of MCAP."""
    return struct.pack("<BQ", opcode, len(content)) + content


def counted(content):
    """Return bytes after their count."""
    return struct.pack("<I", len(content)) + content


def text(content):
    """Return a string of MCAP."""
    return counted(content.encode())


FRAMES = "frame_ids: [tam_front, tam_left, tam_back, tam_right]"

BAGS = [
    Foreign("robot", drivers_of_a_robot),
    Foreign("vectors", vectors_and_slow_scalar, INSPECTED, STAGGERED),
    Foreign(
        "own_message",
        own_message,
        INSPECTED,
        array=f"{{baseline_m: 0.5, vector_noise_nT: 1.0, scalar_noise_nT: 0.1, {FRAMES}}}\n",
    ),
    Foreign(
        "adc",
        thirteen_numbers,
        MAPPED,
        map="time: received\nsensors:\n"
        + "".join(
            f'  - {{topic: /adc, fields: ["data[{k}]", "data[{k + 1}]", "data[{k + 2}]"], unit: nT}}\n'
            for k in (0, 3, 6, 9)
        )
        + 'scalar: {topic: /adc, field: "data[12]", unit: nT}\n',
    ),
    Foreign("boat", gauss_by_strange_names, INSPECTED, STAGGERED),
    Foreign("zero_stamps", zero_stamps, INSPECTED, STAGGERED),
    Foreign("ros1.bag", ros1, DIRECT),
    Foreign("json_beside.mcap", json_beside, DIRECT),
]
