"""Messages that the nodes publish fast: all but stamp and numbers serialised once; point clouds of float64 columns."""

import array
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import groupby
from typing import Any

import numpy as np
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from tam_calibration.messages.point_cloud import FLOAT64_SIZE, POINT_FIELD_FLOAT64, SampleLayout, field_offsets
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

STAMP = slice(4, 12)
"""Where a serialised message has the stamp of its header."""

_STAMP = struct.Struct("<iI")


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
        PointField(name=name, offset=offset, datatype=POINT_FIELD_FLOAT64, count=1)
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
        field.offset == offset and field.datatype == POINT_FIELD_FLOAT64 and field.count == 1
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


@lru_cache(maxsize=8)
def layout_of(columns: tuple[str, ...], sensor_count: int) -> SampleLayout:
    """Return the layout of samples of so many sensors that has these columns.

    Raises
    ------
    InputError
        When no layout has them.
    """
    layout = SampleLayout.from_columns(columns)
    if layout.sensor_count != sensor_count:
        raise InputError(f"samples of {layout.sensor_count} sensors, the array has {sensor_count}")
    return layout
