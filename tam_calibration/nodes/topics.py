"""How nodes read and publish topics: serialised, in the order of arrival, many at once, filled in without objects."""

import array
import math
import struct
import time
from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from itertools import chain, groupby
from operator import itemgetter
from typing import Any

import numpy as np
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.context import Context
from rclpy.event_handler import QoSSubscriptionEventType
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.serialization import deserialize_message, serialize_message
from rclpy.subscription import Subscription
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from tam_calibration.messages.cdr import BODY
from tam_calibration.messages.point_cloud import FLOAT64_SIZE, field_offsets
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For what a late joiner must still get."""

STREAM = QoSProfile(depth=10_000, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Sensor data; deep enough to bridge ten seconds at 1000 Hz."""

RELIABLE_STREAM = QoSProfile(depth=STREAM.depth, reliability=ReliabilityPolicy.RELIABLE)
"""Data between our own nodes, of which none may be lost."""

_OVERRIDABLE = QoSOverridingOptions(
    [QoSPolicyKind.DEPTH, QoSPolicyKind.DURABILITY, QoSPolicyKind.HISTORY, QoSPolicyKind.RELIABILITY]
)


class ListeningNode(Node):
    """A node that publishes and reads topics whose quality of service parameters may override (``qos_overrides.…``)."""

    def __init__(self, name: str, context: Context | None = None) -> None:
        self._unwatched: list[Subscription] = []
        self._in_order: list[tuple[Subscription, Callable[[bytes, int], None]]] = []
        super().__init__(name, context=context, automatically_declare_parameters_from_overrides=True)

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions that an executor waits on: not those that are read in turns."""
        yield from (each for each in super().subscriptions if each not in self._unwatched)

    @property
    def all_subscriptions(self) -> Iterator[Subscription]:
        """The subscriptions, also those that are read in turns."""
        yield from super().subscriptions

    def offer(self, message_type: Any, topic: str, quality: QoSProfile) -> Publisher:
        """Return a publisher whose quality of service parameters may override (``qos_overrides.…``).

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        quality : QoSProfile
            Used where no parameter says otherwise.
        """
        return self.create_publisher(message_type, topic, copy(quality), qos_overriding_options=_OVERRIDABLE)

    def listen(self, message_type: Any, topic: str, take: Callable[[bytes], None], quality: QoSProfile) -> Subscription:
        """Have a function called with every serialised message of a topic; parameters may override the quality.

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        take : callable
            Called with each message.
        quality : QoSProfile
            Used where no parameter says otherwise.
        """
        return self.create_subscription(
            message_type, topic, take, copy(quality), raw=True, qos_overriding_options=_OVERRIDABLE
        )

    def listen_to_all(
        self, message_type: Any, topic: str, take: Callable[[list[bytes]], None], quality: QoSProfile
    ) -> None:
        """Have a function called with all serialised messages that wait, oldest first.

        A node that falls behind gets more of them in a call, so that each costs less and it catches up.

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        take : callable
            Called with the list of the messages.
        quality : QoSProfile
            Used where no parameter says otherwise; its depth bounds how many wait.
        """

        def take_waiting(first: bytes) -> None:
            take([first, *waiting(subscription)])

        subscription = self.listen(message_type, topic, take_waiting, quality)

    def listen_in_order(
        self, message_type: Any, topic: str, take: Callable[[bytes, int], None], quality: QoSProfile
    ) -> Callable[[], int]:
        """Have a function called with every serialised message of a topic, and when it arrived, nanoseconds.

        The messages of all topics that are read so come in the order in which they arrived. A node that falls behind
        takes what waits on all of them at once, at a third of the cost, and catches up. The message that wakes it comes
        first, for the executor of events does not say when it arrived.

        Parameters
        ----------
        message_type : type
            Class of the messages.
        topic : str
            Name, relative or absolute.
        take : callable
            Called with each message.
        quality : QoSProfile
            Used where no parameter says otherwise; its depth bounds how many wait.

        Returns
        -------
        callable
            Returns how many messages were lost on the way since it was called last.
        """
        take_waiting = partial(self._take_in_order, len(self._in_order))
        subscription = self.listen(message_type, topic, take_waiting, quality)
        self._in_order.append((subscription, take))
        lost = QoSSubscriptionEventType.RCL_SUBSCRIPTION_MESSAGE_LOST
        event = rclpy_implementation.EventHandle(subscription.handle, lost)
        return lambda: int(event.take_event().total_count_change)

    def _take_in_order(self, turn: int, first: bytes) -> None:
        subscription, take = self._in_order[turn]
        now_ns = time.time_ns()
        later = list(_arrived(subscription, take, now_ns))
        take(first, later[0][0] - 1 if later else now_ns)
        if later:
            others = (_arrived(*other, now_ns) for other in self._in_order if other[0] is not subscription)
            for arrived_ns, take_one, message in sorted(chain(later, *others), key=itemgetter(0)):
                take_one(message, arrived_ns)

    def listen_in_turns(
        self, topics: Sequence[tuple[Any, str, Callable[[list[bytes]], None]]], period_s: float, quality: QoSProfile
    ) -> None:
        """Have functions called with all serialised messages that wait, topic after topic, once in a period.

        A message that comes in between does not even wake the process.

        Parameters
        ----------
        topics : sequence of type, str and callable
            Type and name of each topic, and what is called.
        period_s : float
            Time from turn to turn, seconds.
        quality : QoSProfile
            Its depth must hold what comes in a period.
        """
        read = [(self.listen(message_type, topic, leave, quality), take) for message_type, topic, take in topics]
        self._unwatched += [subscription for subscription, _ in read]

        def turn() -> None:
            for subscription, take in read:
                if messages := list(waiting(subscription)):
                    take(messages)

        self.create_steady_timer(period_s, turn)

    def create_steady_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Have a function called periodically, whatever the time on /clock.

        Parameters
        ----------
        period_s : float
            Time from call to call, seconds.
        callback : callable
            Called without arguments.
        """
        self.create_timer(period_s, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def type_name(kind: Any) -> str:
    """Return the name of a message's class, such as ``sensor_msgs/msg/Imu``."""
    return f"{kind.__module__.partition('.')[0]}/msg/{kind.__name__}"


def message_class(name: str) -> Any:
    """Return the class of messages of a type, such as ``sensor_msgs/msg/Imu``; None where it is not installed."""
    package, *_, message = name.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), message)
    except (ImportError, AttributeError, ValueError):
        return None


def leave(message: bytes, arrived_ns: int = 0) -> None:
    """Stands for the callback of a subscription that no executor waits on."""


def waiting(subscription: Subscription) -> Iterator[bytes]:
    """Take the serialised messages that wait in a subscription, as many as there are room for in its queue."""
    yield from (message for _, _, message in _arrived(subscription, leave, math.inf))


def _arrived(
    subscription: Subscription, take: Callable[[bytes, int], None], until_ns: float
) -> Iterator[tuple[int, Callable[[bytes, int], None], bytes]]:
    """Take what waits in a subscription up to a time: when it arrived (ns), what is to be called, the message.

    What arrives meanwhile is left, but for one message: another subscription may have been read before it came.
    """
    arrived_ns = 0
    with subscription.handle:
        for _ in range(subscription.qos_profile.depth):
            taken = subscription.handle.take_message(subscription.msg_type, True) if arrived_ns <= until_ns else None
            if taken is None:
                return
            arrived_ns = taken[1]["received_timestamp"]
            yield arrived_ns, take, taken[0]


_STAMP = struct.Struct("<iI")
STAMP = slice(BODY, BODY + _STAMP.size)
"""Where a serialised message has the stamp of its header."""


class MessageWriter:
    """Serialises messages that differ in the stamp of their header and in some doubles alone.

    Parameters
    ----------
    message : ROS message
        All but its stamp, where it has a header, and some doubles is kept.
    doubles : int
        Number of doubles that differ from message to message.
    behind : int
        Bytes behind these doubles; what else is there fills up to a multiple of four.
    """

    def __init__(self, message: Any, doubles: int, behind: int = 0) -> None:
        template, size = serialize_message(message), FLOAT64_SIZE * doubles
        start = (len(template) - size - behind) & -4  # a multiple of four
        stamp = STAMP if hasattr(message, "header") else slice(start, start)
        self._before_stamp, self._before_doubles = template[: stamp.start], template[stamp.stop : start]
        self._after_doubles = template[start + size :]

    def message(self, stamp: bytes, doubles: bytes) -> bytes:
        """Return a serialised message.

        Parameters
        ----------
        stamp : bytes
            As of `to_stamp`; empty for a message without header.
        doubles : bytes
            Little-endian, as many as the writer was made for.
        """
        return b"".join((self._before_stamp, stamp, self._before_doubles, doubles, self._after_doubles))


def to_stamp(stamp_ns: int) -> bytes:
    """Return a stamp as it is in messages."""
    return _STAMP.pack(*divmod(stamp_ns, 1_000_000_000))


def from_stamp(stamp: bytes) -> int:
    """Return a stamp of a message in nanoseconds."""
    seconds, nanoseconds = _STAMP.unpack(stamp)
    return int(seconds * 1_000_000_000 + min(nanoseconds, 999_999_999))


_LITTLE_ENDIAN = b"\0\1"
_AFTER_DATA = 1
"""Bytes of a serialised cloud behind its data."""


def make_cloud(header: Header, columns: tuple[str, ...], row: Sequence[float] = ()) -> PointCloud2:
    """Return a cloud of one row, or of none.

    Parameters
    ----------
    header : Header
        Stamp and frame of the row.
    columns : tuple of str
        Names of the fields.
    row : sequence of float
        A value for each column; empty for a cloud without a row.
    """
    size = FLOAT64_SIZE * len(columns)
    cloud = PointCloud2(header=header, height=1, width=1 if row else 0)
    cloud.fields = [
        PointField(name=name, offset=offset, datatype=PointField.FLOAT64, count=1)
        for name, offset in field_offsets(columns)
    ]
    cloud.point_step, cloud.row_step, cloud.is_dense = size, size if row else 0, True
    cloud.data = array.array("B", struct.pack(f"<{len(row)}d", *row))
    return cloud


def read_cloud(cloud: PointCloud2) -> tuple[tuple[str, ...], FloatArray]:
    """Return the names of the columns of a cloud and its (N, columns) rows.

    Raises
    ------
    InputError
        When the cloud is not made of little-endian float64 columns without gaps.
    """
    columns = tuple(field.name for field in cloud.fields)
    is_plain = all(
        field.offset == offset and field.datatype == PointField.FLOAT64 and field.count == 1
        for field, (_, offset) in zip(cloud.fields, field_offsets(columns), strict=True)
    )
    if not is_plain or cloud.is_bigendian or cloud.point_step != FLOAT64_SIZE * len(columns):
        raise InputError("the point cloud is not made of little-endian float64 columns without gaps")
    if len(cloud.data) != cloud.width * cloud.height * cloud.point_step:
        raise InputError(f"the point cloud has {len(cloud.data)} bytes, not {cloud.width * cloud.height} rows")
    return columns, np.frombuffer(cloud.data, "<f8").reshape(-1, max(len(columns), 1))


def cloud_writer(columns: tuple[str, ...], frame_id: str) -> MessageWriter:
    """Return what serialises clouds of one row that differ in stamp and numbers alone.

    Parameters
    ----------
    columns : tuple of str
        Names of the fields.
    frame_id : str
        Frame of the header.
    """
    cloud = make_cloud(Header(frame_id=frame_id), columns, [0.0] * len(columns))
    return MessageWriter(cloud, len(columns), _AFTER_DATA)


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of clouds that follow each other.

    Parameters
    ----------
    columns : tuple of str
        Names of the columns.
    stamps : list of bytes
        Stamp of the cloud of each row, as in messages.
    values : (N, columns) array
        The rows; none where the cloud was empty.
    """

    columns: tuple[str, ...]
    stamps: list[bytes]
    values: FloatArray


class CloudReader:
    """Reads serialised clouds, many at once if their layouts agree; a layout that was seen before is not parsed again.

    Parameters
    ----------
    refuse : callable
        Called with what is wrong with a cloud that cannot be used; the others are not lost by it.
    check : callable
        Called with the columns of clouds; what raises `InputError` is not used.

    Attributes
    ----------
    problem : str
        What is wrong with the newest cloud; empty where nothing is.
    """

    def __init__(self, refuse: Callable[[str], None], check: Callable[[tuple[str, ...]], object]) -> None:
        self._refuse, self._check, self.problem = refuse, check, ""
        self._columns: tuple[str, ...] = ()
        # All that clouds of one row have in common between stamp and numbers, where these are, and the size of a cloud.
        self._between, self._data, self._size = b"", slice(0), 0

    def read(self, messages: Sequence[bytes]) -> Iterator[Rows]:
        """Yield the rows of clouds in their order."""
        for is_known, alike in groupby(messages, self._is_known):
            if is_known:
                self.problem = ""
                yield self._rows(list(alike))
            else:
                for message in alike:
                    try:
                        yield self._parse(message)
                    except InputError as problem:
                        self.problem = str(problem)
                        self._refuse(self.problem)

    def _is_known(self, message: bytes) -> bool:
        is_alike = len(message) == self._size and message.startswith(self._between, STAMP.stop)
        return is_alike and message.startswith(_LITTLE_ENDIAN)

    def _rows(self, messages: Sequence[bytes]) -> Rows:
        data = b"".join([message[self._data] for message in messages])
        values = np.frombuffer(data, "<f8").reshape(len(messages), -1)
        return Rows(self._columns, [message[STAMP] for message in messages], values)

    def _parse(self, message: bytes) -> Rows:
        try:
            cloud: PointCloud2 = deserialize_message(message, PointCloud2)
        except rclpy_implementation.RMWError:
            raise InputError("the point cloud is damaged, or not in the serialisation CDR") from None
        columns, values = read_cloud(cloud)
        self._check(columns)
        self.problem = ""
        if len(values) == 1 and message.startswith(_LITTLE_ENDIAN):
            size = FLOAT64_SIZE * len(columns)
            start = (len(message) - size - _AFTER_DATA) & -4  # a multiple of four
            self._columns, self._size = columns, len(message)
            self._between, self._data = message[STAMP.stop : start], slice(start, start + size)
        stamp = _STAMP.pack(cloud.header.stamp.sec, cloud.header.stamp.nanosec)
        return Rows(columns, [stamp] * len(values), values)
