"""Recordings of a turned sensor to be inspected: bags written by rosbags alone, and texts."""

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
FIELD = "sensor_msgs/msg/MagneticField"
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 50_000_000
COUNT = 400


def turned(size=48e-6, count=COUNT, sensor=0):
    """Return readings (count, 3) of a field of some size, smooth and in all directions, with a bias and noise."""
    rng = np.random.default_rng(sensor)
    time = np.linspace(0, 1, count)
    height = np.cos(np.pi * time)
    level, angle = np.sqrt(1 - height**2), 60 * time
    directions = np.column_stack([level * np.cos(angle), level * np.sin(angle), height])
    return size * (directions + 0.02 * (sensor + 1) + 1e-4 * rng.normal(size=(count, 3)))


def times(count=COUNT, first_ns=START_NS):
    """Return even times, nanoseconds."""
    return first_ns + PERIOD_NS * np.arange(count)


def message(kind, *values):
    """Return a message of rosbags."""
    return STORE.types[kind](*values)


def header(stamp_ns, frame="mag"):
    """Return a header."""
    time = message("builtin_interfaces/msg/Time", int(stamp_ns) // 10**9, int(stamp_ns) % 10**9)
    return message("std_msgs/msg/Header", time, frame)


def vector(values):
    """Return a vector."""
    return message("geometry_msgs/msg/Vector3", *map(float, values))


def fields(readings, stamps_ns, frame="mag"):
    """Return messages MagneticField."""
    return [
        message(FIELD, header(stamp_ns, frame), vector(reading), np.zeros(9))
        for reading, stamp_ns in zip(readings, stamps_ns, strict=True)
    ]


def numbers(values, kind="std_msgs/msg/Float64"):
    """Return messages of single numbers."""
    return [message(kind, float(value)) for value in values]


def write_bag(path, topics, plugin=StoragePlugin.MCAP):
    """Write a bag of topics, each with its messages and times of recording, in the order of these."""
    with Writer(path, version=9, storage_plugin=plugin) as writer:
        rows = []
        for topic, (messages, received_ns) in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(topic, kind, typestore=STORE)
            rows += [
                (int(time), connection, bytes(STORE.serialize_cdr(each, kind)))
                for each, time in zip(messages, received_ns, strict=True)
            ]
        for time, connection, content in sorted(rows, key=lambda row: row[0]):
            writer.write(connection, time, content)
    return path


def write_text(path, columns, delimiter=","):
    """Write a text of columns by their names."""
    rows = zip(*(map(str, values) for values in columns.values()), strict=True)
    path.write_text("\n".join([delimiter.join(columns), *(delimiter.join(row) for row in rows)]) + "\n")
    return path


def columns_of(name, readings):
    """Return the columns of a vector, its axis behind the name."""
    return {f"{name}{axis}": np.round(column, 2) for axis, column in zip("xyz", readings.T, strict=True)}
