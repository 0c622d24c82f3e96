"""Writing of bags: blocks of messages, copied topics, recordings, and the complete messages of damaged bags."""

import logging
import sqlite3
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from tam_calibration.files.text_files import require_regular, temporary_place, unfinished, write_whole
from tam_calibration.messages.cdr import ByteArray, RawMessages, fill, interleave
from tam_calibration.messages.point_cloud import FLOAT64, FRAME_ID, IMU, MAGNETIC_FIELD, TEMPERATURE, topic_and_type
from tam_calibration.messages.samples import pieces, stamps_of
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings import bag_storages
from tam_calibration.recordings.bag_bounds import damage_named, unpacked
from tam_calibration.recordings.bag_reader import BagReader, Recovered, RecoveredFile, raw_blocks
from tam_calibration.recordings.bag_storages import DEFAULT, data_files, serialisation_of

TYPESTORE = get_typestore(Stores.ROS2_JAZZY)
_TYPES = TYPESTORE.types


class BlockWriter(Writer):
    """The writer of rosbags that takes single messages, or many at once."""

    def __init__(self, path: Path, storage: str) -> None:
        known = bag_storages.written()
        if storage not in known:
            raise InputError(f"storage {storage!r} is not known: choose one of {', '.join(known)}")
        plugin: Any = known[storage]  # rosbags takes its name for metadata.yaml
        super().__init__(path, version=9, storage_plugin=plugin)
        self.STORAGE_PLUGINS = {plugin: plugin.load().WRITER}

    def write_block(self, messages: RawMessages) -> None:
        """Write messages, each of the connection of that id, in their order.

        Parameters
        ----------
        messages : RawMessages
            Their connections are ids of this writer's.
        """
        if not len(messages):
            return
        storage: Any = self.storage
        storage.write_block(messages)
        for number, count in zip(*np.unique(messages.connection, return_counts=True), strict=True):
            self.counts[int(number)] += int(count)
        self.min_timestamp = min(int(messages.recorded_ns.min()), self.min_timestamp)
        self.max_timestamp = max(int(messages.recorded_ns.max()), self.max_timestamp)


@contextmanager
def write_bag(path: Path, storage: str) -> Iterator[BlockWriter]:
    """Give a writer of a bag that appears complete: a folder, or a single file where its storage has single files.

    Parameters
    ----------
    path : Path
        Where the bag appears once it is complete; a file that is there is replaced, a folder is not.
    storage : str
        What a folder contains: a name in ``bag_storages.STORAGES``. A single file has the storage of its suffix.

    Raises
    ------
    InputError
        When the bag cannot be written.
    """
    alone = bag_storages.storage_alone(path)
    if not alone and path.name.encode("utf-8", "replace").decode() != path.name:
        raise InputError(f"{path} is no name for a bag, which must be of UTF-8 characters: choose another")
    with write_whole(path) as temporary:
        folder = temporary.with_name("bag") if alone else temporary
        try:
            with BlockWriter(folder, alone.name if alone else storage) as writer:
                yield writer
        except sqlite3.Error as problem:
            raise InputError(f"{path} cannot be written: {problem}") from problem
        if alone:
            next(folder.glob(f"*{alone.suffix}")).rename(temporary)


def copy_connection(writer: BlockWriter, connection: Connection) -> Connection:
    """Make a connection of another bag known to a writer, and return the writer's own."""
    extra: Any = connection.ext
    return writer.add_connection(
        connection.topic,
        connection.msgtype,
        msgdef=connection.msgdef.data,
        rihs01=connection.digest or "RIHS01_" + "0" * 64,
        serialization_format=serialisation_of(connection),
        offered_qos_profiles=extra.offered_qos_profiles,
    )


def write_bag_recording(path: Path, recording: Recording, storage: str = DEFAULT) -> None:
    """Write a recording as the topics that sensors publish, the scalar as a stamped field of that intensity.

    Parameters
    ----------
    path : Path
        The bag to write: a folder, or a single file where its storage has single files.
    recording : Recording
        Its times become stamps; a topic has no message where its values are NaN.
    storage : str
        What a folder contains: a name in ``bag_storages.STORAGES``.

    Raises
    ------
    InputError
        When a time is no stamp, or the bag cannot be written.
    """
    stamps_ns = stamps_of(recording.time_s)
    streams = {sensor_stream(sensor + 1): recording.readings_T[:, sensor] for sensor in range(recording.sensor_count)}
    for channel, values in (
        ("scalar", recording.scalar_T),
        ("temperature", recording.temperature_C),
        ("current", recording.current_A),
        ("attitude", _imu_rows(recording)),
        *recording.further.items(),
    ):
        if values is not None:
            streams[channel] = values.reshape(len(values), -1)
    with write_bag(path, storage) as writer:
        _write_rows(writer, stamps_ns, streams)


def _imu_rows(recording: Recording) -> FloatArray | None:
    """Return the (N, 25) numbers of an IMU: attitude and angular velocity, each before its covariance; None of neither.

    The first number of a covariance is -1 where there is no value, and 0 where its errors are not known.
    """
    parts = []
    for values, absent in ((recording.attitude, (0.0, 0.0, 0.0, 1.0)), (recording.angular_velocity_rad_s, (0.0,) * 3)):
        rows = np.full((recording.sample_count, len(absent)), np.nan) if values is None else values
        is_known = np.asarray(np.isfinite(rows).all(axis=1))
        covariance = np.zeros((len(rows), 9))
        covariance[~is_known, 0] = -1
        parts += [np.where(is_known[:, None], rows, absent), covariance]
    numbers = np.concatenate(parts, axis=1)
    numbers[(numbers[:, 4] == -1) & (numbers[:, 16] == -1)] = np.nan
    return None if np.isnan(numbers).all() else numbers


def _write_rows(writer: BlockWriter, stamps_ns: IntArray, streams: Mapping[str, FloatArray]) -> None:
    """Write a message for each row of each stream, sample by sample; rows with NaN are left out."""
    topics = [(*topic_and_type(stream), values) for stream, values in streams.items()]
    ids = [writer.add_connection(f"/{topic}", msgtype, typestore=TYPESTORE).id for topic, msgtype, _ in topics]
    for piece in pieces(len(stamps_ns)):
        parts, places = [], []
        for number, (_, msgtype, values) in zip(ids, topics, strict=True):
            known = np.flatnonzero(np.isfinite(values[piece]).all(axis=1))
            stamps = stamps_ns[piece][known]
            parts.append(RawMessages.of_rows(number, stamps, serialise(msgtype, values[piece][known], stamps)))
            places.append(known)
        writer.write_block(interleave(parts, places))


def serialise(msgtype: str, values: FloatArray, stamps_ns: IntArray) -> ByteArray:
    """Return (N, bytes) serialised messages of a sensor's type, one for each row of values.

    Parameters
    ----------
    msgtype : str
        ROS type of the messages: ``MAGNETIC_FIELD``, ``TEMPERATURE``, ``FLOAT64`` or ``IMU``.
    values : (N, n) array
        Doubles of each message: field, tesla (n = 3), temperature, °C, or current, A (1), or of an IMU
        its first doubles: the quaternion x, y, z, w, its covariance (9), the angular velocity, rad/s, and its own.
    stamps_ns : (N,) array of int
        Stamps of the headers, nanoseconds; ``FLOAT64`` has none.
    """
    template, from_end, has_header = _TEMPLATES[msgtype]
    return fill(template, from_end, values, stamps_ns if has_header else None)


def header() -> Any:
    """Return a header in the array frame, its stamp to be filled in."""
    return _TYPES["std_msgs/msg/Header"](_TYPES["builtin_interfaces/msg/Time"](0, 0), FRAME_ID)


def _make_templates() -> dict[str, tuple[bytes, int, bool]]:
    """Return for each type a serialised message, the bytes from its values to the end, and whether it has a header."""
    zero = _TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    quaternion = _TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
    unknown, none = np.zeros(9), np.array([-1.0, *[0.0] * 8])
    messages = {
        MAGNETIC_FIELD: (_TYPES[MAGNETIC_FIELD](header(), zero, unknown), 12, True),
        TEMPERATURE: (_TYPES[TEMPERATURE](header(), 0.0, 0.0), 2, True),
        FLOAT64: (_TYPES[FLOAT64](0.0), 1, False),
        IMU: (_TYPES[IMU](header(), quaternion, unknown, zero, none, zero, none), 37, True),
    }
    return {
        msgtype: (bytes(TYPESTORE.serialize_cdr(message, msgtype)), 8 * doubles, has_header)
        for msgtype, (message, doubles, has_header) in messages.items()
    }


_TEMPLATES = _make_templates()


log = logging.getLogger(__name__)


def recover(path: Path, target: Path) -> Recovered:
    """Write a bag of all messages of another that are complete, in the order in which they were written.

    Parameters
    ----------
    path : Path
        The bag, which may be unfinished or damaged, and is not changed.
    target : Path
        The bag to write: a folder of the same storage, or a single file where its storage has single files.

    Raises
    ------
    InputError
        When it is no bag, no message of it is complete, or the new one cannot be written.
    """
    require_regular(path)
    faults: list[str] = []
    with unfinished(temporary_place()) as folder:
        files = data_files(path)
        with damage_named(path, may_recover=False):
            files = unpacked(files, folder, faults)
            faults += [f"{file.name} is missing" for file in files if not file.exists()]
            bag = BagReader(path, [RecoveredFile(file, faults) for file in files if file.exists()])
        readable = [one for one in bag.topics if serialisation_of(one) in bag_storages.READABLE]
        if not readable:
            raise InputError(f"{path} is damaged or truncated: no message in it is complete")
        with write_bag(target, bag_storages.storage_of(path)) as writer:
            ids = np.array([copy_connection(writer, one).id for one in readable])
            for block in raw_blocks(bag, readable):
                writer.write_block(replace(block, connection=ids[block.connection]))
    for one in bag.topics:
        if one not in readable:
            encoding = serialisation_of(one)
            log.warning("%s: %d messages of %s in %s are left out", path, one.msgcount, one.topic, encoding)
    count = sum(one.msgcount for one in readable)
    return Recovered(count, bag.start_time, bag.start_time + bag.duration, tuple(faults))
