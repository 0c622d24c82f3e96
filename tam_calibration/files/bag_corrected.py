"""Corrected data as the topics of the corrector node, beside everything else that was in the bag."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag2 import Reader, Writer

from tam_calibration.calibration import Corrected
from tam_calibration.files.bag import open_bag, raw_messages, storage_of
from tam_calibration.files.bag_topics import find_topics
from tam_calibration.files.bag_writing import TYPESTORE, header, write_bag
from tam_calibration.files.cdr import StampedDoubles, fill
from tam_calibration.pointcloud_layout import (
    FIELD_GRADIENT_COLUMNS,
    FLOAT64_SIZE,
    GRADIENT_DIMENSIONS,
    GRADIENT_ROW_MAJOR,
    POINT_FIELD_FLOAT64,
    center_covariance,
    field_offsets,
)

MAGNETIC_FIELD, MULTI_ARRAY = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64MultiArray"
POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
TOPIC_TYPES = {"center": MAGNETIC_FIELD, "gradient": MULTI_ARRAY, "field_gradient": POINT_CLOUD}

_TYPES = TYPESTORE.types


def write_bag_corrected(
    path: Path, corrected: Corrected, stamps_ns: NDArray[np.int64], source: Path | None = None
) -> None:
    """Write a bag with ``center``, ``gradient`` and ``field_gradient`` as the corrector publishes them.

    Parameters
    ----------
    path : Path
        The bag to write.
    corrected : Corrected
        The results.
    stamps_ns : (N,) array of int
        Their stamps.
    source : Path, optional
        Bag of the raw readings, whose storage is kept and whose other topics are carried over unchanged; each
        result stands behind the reading of sensor 1 that it came from.

    Raises
    ------
    InputError
        When the source cannot be read or the bag cannot be written.
    """
    results = _serialise(corrected, stamps_ns)
    with write_bag(path, "sqlite3" if source is None else storage_of(source)) as writer:
        if source is None:
            connections = _add_topics(writer, "/", list(results))
            for stamp_ns, row in zip(stamps_ns.tolist(), zip(*results.values(), strict=True), strict=True):
                _write_row(writer, connections, stamp_ns, row)
        else:
            with open_bag(source) as reader:
                _merge(reader, writer, stamps_ns, results)


def _merge(reader: Reader, writer: Writer, stamps_ns: NDArray[np.int64], results: dict[str, Iterator[bytes]]) -> None:
    topics = find_topics(reader.connections, None)
    replaced = {topics.namespace + topic for topic in TOPIC_TYPES}
    kept = [connection for connection in reader.connections if connection.topic not in replaced]
    copies = {connection.id: _copy_connection(writer, connection) for connection in kept}
    added = _add_topics(writer, topics.namespace, list(results))
    rows = zip(stamps_ns.tolist(), zip(*results.values(), strict=True), strict=True)
    pace, read = topics.connections["tam_1"].topic, StampedDoubles(3).read
    due, row = next(rows)
    for connection, recorded_ns, message in raw_messages(reader, kept):
        writer.write(copies[connection.id], recorded_ns, message)
        if connection.topic == pace and read(message)[0] == due:
            _write_row(writer, added, recorded_ns, row)
            due, row = next(rows, (None, ()))


def _copy_connection(writer: Writer, connection: Connection) -> Connection:
    assert isinstance(connection.ext, ConnectionExtRosbag2)
    return writer.add_connection(
        connection.topic,
        connection.msgtype,
        msgdef=connection.msgdef.data,
        rihs01=connection.digest or "RIHS01_" + "0" * 64,
        serialization_format=connection.ext.serialization_format,
        offered_qos_profiles=connection.ext.offered_qos_profiles,
    )


def _add_topics(writer: Writer, namespace: str, topics: list[str]) -> list[Connection]:
    return [writer.add_connection(namespace + topic, TOPIC_TYPES[topic], typestore=TYPESTORE) for topic in topics]


def _write_row(writer: Writer, connections: list[Connection], recorded_ns: int, row: tuple[bytes, ...]) -> None:
    for connection, message in zip(connections, row, strict=True):
        writer.write(connection, recorded_ns, message)


def _serialise(corrected: Corrected, stamps_ns: NDArray[np.int64]) -> dict[str, Iterator[bytes]]:
    outputs = corrected.outputs
    errors = np.broadcast_to(corrected.standard_errors, outputs.shape)
    center, gradient, cloud = _center_template(corrected), _gradient_template(), _cloud_template()
    messages = {
        "center": fill(center, 12 * FLOAT64_SIZE, outputs[:, :3], stamps_ns),
        "gradient": fill(gradient, 9 * FLOAT64_SIZE, outputs[:, GRADIENT_ROW_MAJOR], None),
        "field_gradient": fill(cloud, 18 * FLOAT64_SIZE + 1, np.hstack([outputs, errors]), stamps_ns),
    }
    if not np.isfinite(outputs[:, 3:]).any():
        del messages["gradient"]
    return messages


def _center_template(corrected: Corrected) -> bytes:
    zero = _TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    message = _TYPES[MAGNETIC_FIELD](header(), zero, center_covariance(corrected.standard_errors))
    return bytes(TYPESTORE.serialize_cdr(message, MAGNETIC_FIELD))


def _gradient_template() -> bytes:
    dimension, layout = _TYPES["std_msgs/msg/MultiArrayDimension"], _TYPES["std_msgs/msg/MultiArrayLayout"]
    message = _TYPES[MULTI_ARRAY](layout([dimension(*each) for each in GRADIENT_DIMENSIONS], 0), np.zeros(9))
    return bytes(TYPESTORE.serialize_cdr(message, MULTI_ARRAY))


def _cloud_template() -> bytes:
    point_field = _TYPES["sensor_msgs/msg/PointField"]
    fields = [
        point_field(name, offset, POINT_FIELD_FLOAT64, 1) for name, offset in field_offsets(FIELD_GRADIENT_COLUMNS)
    ]
    size = FLOAT64_SIZE * len(FIELD_GRADIENT_COLUMNS)
    data = np.zeros(size, np.uint8)
    message = _TYPES[POINT_CLOUD](header(), 1, 1, fields, False, size, size, data, True)
    return bytes(TYPESTORE.serialize_cdr(message, POINT_CLOUD))
