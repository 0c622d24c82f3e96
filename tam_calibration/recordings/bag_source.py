"""A bag as tables: its topics, and the numbers in their messages."""

from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, cached_property

import numpy as np
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore

from tam_calibration.files.text_files import in_file
from tam_calibration.messages.cdr import RawMessages, in_large_blocks, read_frame_id
from tam_calibration.messages.message_fields import Definitions, MessageFields, stamp_fields
from tam_calibration.messages.point_cloud import FIELD_UNITS, IMU
from tam_calibration.messages.samples import Progress, StreamMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.bag_reader import BagReader, raw_blocks
from tam_calibration.recordings.bag_storages import serialisation_of
from tam_calibration.recordings.channel_map import Clock
from tam_calibration.recordings.tables import BATCH, Batches, Table, Wanted, by_stream, fields_of

_Decoder = Callable[[RawMessages], tuple[IntArray | None, FloatArray]]
"""Returns the (n,) stamps, where there are any, and the (n, values) of messages."""


_ORIENTATION = tuple(f"orientation.{axis}" for axis in "xyzw")
_RATES = tuple(f"angular_velocity.{axis}" for axis in "xyz")


_OF_IMU = (_ORIENTATION, _RATES, (*_ORIENTATION, *_RATES))
"""What is read of an IMU: its attitude, its angular velocity, or both."""

_IMU_NUMBERS = (*_ORIENTATION, "orientation_covariance[0]", *_RATES, "angular_velocity_covariance[0]")


def _imu_values(
    paths: tuple[str, ...], stamps: IntArray | None, numbers: FloatArray
) -> tuple[IntArray | None, FloatArray]:
    """Return what paths mean of the (n, 9) numbers of an IMU; NaN where a covariance of -1 says that it has none."""
    numbers[(numbers[:, 4] == -1) | ~numbers[:, :4].any(axis=1), :4] = np.nan
    numbers[numbers[:, 8] == -1, 5:8] = np.nan
    return stamps, numbers[:, [_IMU_NUMBERS.index(path) for path in paths]]


class BagSource:
    """The topics of an open bag.

    Parameters
    ----------
    bag : BagReader
        An open bag.
    """

    def __init__(self, bag: BagReader) -> None:
        self.bag = bag
        self.path, self.unfinished = bag.path, bag.unfinished
        self.is_ros1 = any(map(_is_ros1, bag.connections))
        self.format = "ROS 1 bag" if self.is_ros1 else "bag"
        self._connections = {each.topic: each for each in bag.connections}

    @cached_property
    def tables(self) -> list[Table]:
        """The topics, in the order of their names; those whose type is not known have no fields."""
        return [self._table(topic) for topic in sorted(self._connections)]

    def _table(self, topic: str) -> Table:
        connection = self._connections[topic]
        count, publishers = connection.msgcount or None, self._publishers(connection)
        try:
            fields = self._fields(topic)
        except InputError:
            return Table(topic, (), connection.msgtype, 0, count, False, publishers=publishers)
        paths, is_stamped = fields.paths, bool(stamp_fields(connection.msgtype, fields.paths))
        frames: tuple[str, ...] = ()
        first = RawMessages.of([], [], [])
        with suppress(InputError):  # damage is reported when the messages are read
            first = self._first_messages(topic)
            frames = _frames(first) if fields.begins_with_header else ()
            paths = fields.expanded(first)
            stamps_ns = fields.read(first, ())[0]
            is_stamped = stamps_ns is not None and (not len(stamps_ns) or bool(stamps_ns.any()))
        units = FIELD_UNITS.get(connection.msgtype, {})
        # A longer message is no reading: 64 sensors with covariances have 6 kB.
        is_bulky = len(first) > 0 and float(first.size.mean()) > 8192
        return Table(topic, paths, connection.msgtype, 0, count, is_stamped, units, (), publishers, frames, is_bulky)

    def _publishers(self, connection: Connection) -> int:
        """Return the number of publishers of a topic: in ROS 1 each has its connection in a file."""
        kind = connection.topic, connection.msgtype
        return max(sum((one.topic, one.msgtype) == kind for one in file.connections) for file in self.bag.files)

    @cached_property
    def _first_block(self) -> RawMessages | None:
        """The first messages of the bag."""
        return next(raw_blocks(self.bag, list(self._connections.values())), None)

    def _first_messages(self, topic: str) -> RawMessages:
        """Return some of the first messages of a topic."""
        block, number = self._first_block, list(self._connections).index(topic)
        if block is not None and number not in block.connection:
            block, number = next(raw_blocks(self.bag, [self._connections[topic]]), None), 0
        if block is None:
            return RawMessages.of([], [], [])
        return block.take(np.flatnonzero(block.connection == number)[:16])

    def _fields(self, topic: str) -> MessageFields:
        connection = self._connections[topic]
        return _fields_of(connection.msgtype, *connection.msgdef, _is_ros1(connection))

    def batches(self, wanted: Mapping[str, Wanted], clock: Clock, progress: Progress) -> Batches:
        """Yield the messages of some streams, decoded, as `Source.batches`."""
        topics: dict[str, dict[str, Wanted]] = {}
        for stream, each in wanted.items():
            topics.setdefault(each.table.name, {})[stream] = each
        connections = [self._connections[topic] for topic in topics]
        decoders = {topic: self._decoder(topic, fields_of(own)) for topic, own in topics.items()}
        parts: dict[str, list[StreamMessages]] = {stream: [] for stream in wanted}
        count, is_received = 0, clock == "received"
        for block in in_large_blocks(raw_blocks(self.bag, connections, progress)):
            for number, (topic, own) in enumerate(topics.items()):
                order = np.flatnonzero(block.connection == number)
                if not len(order):
                    continue
                messages = block.take(order)
                with in_file(f"topic {topic}"):
                    stamps_ns, values = decoders[topic](messages)
                stamps_ns = messages.recorded_ns if is_received else stamps_ns
                for stream, numbers in by_stream(own, values).items():
                    parts[stream].append(StreamMessages(order + count, stamps_ns, numbers, messages.recorded_ns))
            count += len(block)
            if count >= BATCH:
                yield _concatenated(parts)
                parts, count = {stream: [] for stream in wanted}, 0
        yield _concatenated(parts)

    def stamps(self, topic: str, messages: RawMessages, clock: Clock) -> IntArray:
        """Return the times (n,) of messages of a topic on a clock; those of recording where they have no stamps."""
        stamps_ns = None if clock == "received" else self._decoder(topic, ())(messages)[0]
        return messages.recorded_ns if stamps_ns is None else stamps_ns

    def _decoder(self, topic: str, paths: tuple[str, ...]) -> _Decoder:
        connection, fields = self._connections[topic], self._fields(topic)
        if connection.msgtype == IMU and paths in _OF_IMU:
            return lambda messages: _imu_values(paths, *fields.read(messages, _IMU_NUMBERS))
        return lambda messages: fields.read(messages, paths)


def _frames(messages: RawMessages) -> tuple[str, ...]:
    """Return the frames of messages that begin with a header, each once."""
    return tuple(dict.fromkeys(filter(None, map(read_frame_id, messages.messages()))))


def _is_ros1(connection: Connection) -> bool:
    return serialisation_of(connection) == "ros1"


@cache
def _fields_of(msgtype: str, form: MessageDefinitionFormat, text: str, is_ros1: bool) -> MessageFields:
    """Return the numbers of a type, by the definition that the bag contains, else by that of ROS.

    Raises
    ------
    InputError
        When the type is not known.
    """
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_JAZZY).fielddefs
    definitions: dict[str, tuple[object, object]] = dict(store)
    try:
        if form == MessageDefinitionFormat.MSG:
            definitions |= get_types_from_msg(text, msgtype)
        elif form == MessageDefinitionFormat.IDL:
            definitions |= get_types_from_idl(text)
        own: Definitions = definitions  # type: ignore[assignment]
        return MessageFields(own, msgtype, is_ros1)
    except (TypesysError, KeyError):
        raise InputError(f"the bag does not define {msgtype}, and ROS does not either") from None


def _concatenated(parts: dict[str, list[StreamMessages]]) -> dict[str, StreamMessages]:
    return {name: StreamMessages.concatenate(several) for name, several in parts.items() if several}
