"""Serialised messages of ROS 2 (CDR): stamps, numbers and static transforms, read and filled in without objects."""

import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, IntArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

ByteArray = NDArray[np.uint8]

NO_TIME = -1
"""A stamp that is no time: before 1970, or with more than a second of nanoseconds."""


@dataclass(frozen=True, eq=False)
class RawMessages:
    """Serialised messages, mostly in the order of their recording.

    Parameters
    ----------
    connection : (n,) array of int
        Which of the connections that were asked for each is of.
    recorded_ns : (n,) array of int
        Times of recording, nanoseconds.
    start, size : (n,) array of int
        Where each lies in the block.
    block : (bytes,) array of uint8
        The block that they lie in.
    """

    connection: IntArray
    recorded_ns: IntArray
    start: IntArray
    size: IntArray
    block: ByteArray

    @classmethod
    def of(
        cls, connection: Sequence[int] | IntArray, recorded_ns: Sequence[int] | IntArray, messages: Sequence[bytes]
    ) -> "RawMessages":
        """Return single messages as one block.

        Parameters
        ----------
        connection : (n,) sequence of int
            Which connection each message is of.
        recorded_ns : (n,) sequence of int
            Times of recording, nanoseconds.
        messages : sequence of bytes
            n serialised messages, of any sizes.
        """
        size = np.array([len(message) for message in messages], dtype=np.int64)
        block = np.frombuffer(b"".join(messages), np.uint8)
        return cls(np.array(connection), np.array(recorded_ns), np.cumsum(size) - size, size, block)

    @classmethod
    def of_rows(cls, connection: int, recorded_ns: IntArray, rows: ByteArray) -> "RawMessages":
        """Return messages of one connection that are all of one size.

        Parameters
        ----------
        connection : int
            The connection they are of.
        recorded_ns : (n,) array of int
            Times of recording, nanoseconds.
        rows : (n, bytes) array of uint8
            A serialised message in each row.
        """
        count, size = rows.shape
        start = np.arange(count) * size
        return cls(np.full(count, connection), recorded_ns, start, np.full(count, size), rows.ravel())

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.start)

    def take(self, index: IntArray | NDArray[np.bool_] | slice) -> "RawMessages":
        """Return the messages that a mask, slice or index selects, in the same block."""
        chosen = {name: getattr(self, name)[index] for name in ("connection", "recorded_ns", "start", "size")}
        return replace(self, **chosen)

    def in_order(self) -> "RawMessages":
        """Return the messages in the order of their recording; those of one time stay as they are."""
        is_rising = bool((np.diff(self.recorded_ns) >= 0).all())
        return self if is_rising else self.take(np.argsort(self.recorded_ns, kind="stable"))

    def messages(self) -> list[bytes]:
        """Return the messages one by one."""
        block = self.block.tobytes()
        ends = (self.start + self.size).tolist()
        return [block[start:end] for start, end in zip(self.start.tolist(), ends, strict=True)]


COUNT, _BYTES = 16_384, 8_000_000
"""Most messages and bytes of a block: larger ones leave the processor's caches."""


def gather(messages: Iterable[tuple[int, int, bytes]], size: float = 0.0) -> Iterator[tuple[RawMessages, int]]:
    """Yield blocks of messages, and the bytes read for each.

    Parameters
    ----------
    messages : iterable of (int, int, bytes)
        Number of the connection, time of recording in nanoseconds and serialised message.
    size : float
        Bytes of the file for each message.
    """
    rows: list[tuple[int, int, bytes]] = []
    bytes_gathered = 0
    for row in messages:
        rows.append(row)
        bytes_gathered += len(row[2])
        if len(rows) == COUNT or bytes_gathered > _BYTES:
            yield RawMessages.of(*zip(*rows, strict=True)), round(size * len(rows))
            rows, bytes_gathered = [], 0
    if rows:
        yield RawMessages.of(*zip(*rows, strict=True)), round(size * len(rows))


def join(parts: Sequence[RawMessages]) -> RawMessages:
    """Return several as one, one after another."""
    if len(parts) == 1:
        return parts[0]
    shift = np.cumsum([0, *(len(part.block) for part in parts)])
    start = [part.start + moved for part, moved in zip(parts, shift, strict=False)]
    others = [[getattr(part, name) for part in parts] for name in ("connection", "recorded_ns", "size", "block")]
    connection, recorded_ns, size, block = (np.concatenate(each) for each in others)
    return RawMessages(connection, recorded_ns, np.concatenate(start), size, block)


def in_large_blocks(blocks: Iterable[RawMessages]) -> Iterator[RawMessages]:
    """Yield several small blocks as one, as numpy takes as long for few messages as for many."""
    waiting: list[RawMessages] = []
    for block in blocks:
        waiting.append(block)
        if sum(len(each.block) for each in waiting) > _BYTES or sum(map(len, waiting)) >= COUNT:
            yield join(waiting)
            waiting = []
    if waiting:
        yield join(waiting)


def windows(block: ByteArray, size: int) -> NDArray[np.void]:
    """Return the bytes from each place of a block on as one item, without a copy: made to be indexed.

    Parameters
    ----------
    block : (bytes,) array of uint8
        Contiguous.
    size : int
        Bytes of each item.

    Returns
    -------
    (bytes - size + 1,) array of void
        Item i views the bytes i to i + size - 1; none where the block is shorter than an item.
    """
    return np.ndarray(max(len(block) - size + 1, 0), f"V{size}", block, strides=(1,))


def interleave(parts: Sequence[RawMessages], places: Sequence[IntArray]) -> RawMessages:
    """Return several as one in the order of the places of their messages; at equal places in the order of the parts.

    Parameters
    ----------
    parts : sequence of RawMessages
        Each in its own order.
    places : sequence of (n,) array of int
        For each part the place of each of its n messages in the common order.
    """
    return join(parts).take(np.argsort(np.concatenate(places), kind="stable"))


BODY = 4
"""Bytes before the message, which tell the byte order; alignment counts from here."""


_HEAD_SIZE = struct.calcsize("=iII")
"""Bytes of the stamp, and of the length of the frame's name."""

FRAME_ID = BODY + _HEAD_SIZE
"""Where a serialised message has the name of its frame, a zero at its end."""

_ORDERS = {b"\x00\x01": "<", b"\x00\x00": ">"}
"""Byte orders by the first two bytes of a message."""

_DAMAGED = "a message is damaged: it is too short, or not in the serialisation CDR"


def read_stamp_and_doubles(message: bytes, count: int) -> tuple[int, tuple[float, ...]]:
    """Return stamp, nanoseconds, and doubles of one message: as ``read_stamped_doubles``, faster for a single one.

    Parameters
    ----------
    message : bytes
        Serialised, beginning with a header.
    count : int
        Number of doubles to read behind the header.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR, or its stamp is no time.
    """
    try:
        place = _stamp_and_doubles(message[:2], message[FRAME_ID - 4 : FRAME_ID], count)
        seconds, nanoseconds, *values = place.unpack_from(message)
    except (KeyError, struct.error):
        raise InputError(_DAMAGED) from None
    return stamp_of(seconds, nanoseconds), tuple(values)


@lru_cache(maxsize=64)
def _stamp_and_doubles(order: bytes, length: bytes, count: int) -> struct.Struct:
    """Return where stamp and doubles are in messages of an order whose frames' names have a length."""
    (size,) = struct.unpack(f"{_ORDERS[order]}I", length)
    begin = BODY + (_HEAD_SIZE + size + 7 & -8)
    return struct.Struct(f"{_ORDERS[order]}{BODY}xiI{begin - BODY - 8}x{count}d")


def unpack_from(message: bytes, kinds: str, place: int) -> tuple[Any, ...]:
    """Return the numbers at a place of one message.

    Parameters
    ----------
    message : bytes
        Serialised.
    kinds : str
        Of the numbers, as `struct` names them.
    place : int
        Bytes before them, the byte order included.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    try:
        return struct.unpack_from(_ORDERS[message[:2]] + kinds, message, place)
    except (KeyError, struct.error):
        raise InputError(_DAMAGED) from None


def stamp_of(first: int, nanoseconds: int | None = None) -> int:
    """Return the stamp, nanoseconds, of seconds and nanoseconds, or of microseconds alone.

    Raises
    ------
    InputError
        When it is no time.
    """
    if nanoseconds is None:
        return first * 1000
    if first < 0 or nanoseconds >= 1_000_000_000:
        raise InputError(f"the stamp is no time: {first} s and {nanoseconds} ns; its driver must set header.stamp")
    return first * 1_000_000_000 + nanoseconds


def read_frame_id(message: bytes) -> str:
    """Return the name of the frame of one message that begins with a header.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    *_, length = unpack_from(message, "iII", BODY)
    return message[FRAME_ID : FRAME_ID + length].rstrip(b"\0").decode(errors="replace")


def fill(template: bytes, from_end: int, values: FloatArray, stamps_ns: IntArray | None) -> ByteArray:
    """Return (N, bytes) copies of a serialised message (little-endian) with other numbers and stamps.

    Parameters
    ----------
    template : bytes
        Serialised message.
    from_end : int
        Bytes from the first double that changes to the end of the message.
    values : (N, n) array
        Doubles of each message.
    stamps_ns : (N,) array of int, optional
        Stamps of the header; None for a message without.
    """
    copies = np.tile(np.frombuffer(template, np.uint8), (len(values), 1))
    start = len(template) - from_end
    copies[:, start : start + 8 * values.shape[1]] = np.ascontiguousarray(values, "<f8").view(np.uint8)
    if stamps_ns is not None:
        stamp = np.column_stack(np.divmod(stamps_ns, 1_000_000_000)).astype("<i4")
        copies[:, BODY : BODY + 8] = stamp.view(np.uint8)
    return copies


STATIC_TRANSFORMS = "/tf_static"
"""Where tf2 publishes the transforms that do not change."""


class Transform(NamedTuple):
    """Where a frame is in its parent: its origin (3,), metres, and the quaternion (4,) x, y, z, w of its axes."""

    parent: str
    child: str
    position_m: FloatArray
    rotation: FloatArray


def read_transforms(message: bytes) -> list[Transform]:
    """Return the transforms of a serialised ``tf2_msgs/TFMessage``.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    transforms, (count,), place = [], unpack_from(message, "I", BODY), BODY + 4
    for _ in range(count):
        place = _aligned(place, 4) + 8  # the stamp, which a static transform does not need
        parent, place = _string(message, place)
        child, place = _string(message, place)
        place = _aligned(place, 8)
        numbers = np.array(unpack_from(message, "7d", place))
        transforms.append(Transform(parent, child, numbers[:3], numbers[3:]))
        place += numbers.nbytes
    return transforms


def _aligned(place: int, size: int) -> int:
    """Return the next place at which a number of a size may stand."""
    return BODY + (place - BODY + size - 1 & -size)


def _string(message: bytes, place: int) -> tuple[str, int]:
    """Return a string without its closing zero, and the place behind it."""
    place = _aligned(place, 4)
    (length,) = unpack_from(message, "I", place)
    (text,) = unpack_from(message, f"{length}s", place + 4)
    try:
        return text[:-1].decode(), place + 4 + length
    except UnicodeDecodeError:
        raise InputError("a message of transforms is damaged: the name of a frame is no text") from None


class TransformTree:
    """The newest transform of each frame to its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, Transform] = {}

    def add(self, message: bytes) -> None:
        """Take a serialised ``tf2_msgs/TFMessage``.

        Raises
        ------
        InputError
            When it is damaged.
        """
        self._parents |= {each.child.lstrip("/"): each for each in read_transforms(message)}

    def pose(self, frame: str, target: str) -> tuple[FloatArray, FloatArray] | None:
        """Return where a frame is in another: its origin (3,), metres, and the quaternion (4,) of its axes.

        Parameters
        ----------
        frame, target : str
            Names of frames, with or without a slash before them.

        Returns
        -------
        tuple of array or None
            None where no chain of transforms leads from one to the other.

        Raises
        ------
        InputError
            When a transform on the way has no rotation, or the chain is a circle.
        """
        above = self._ancestors(target.lstrip("/"))
        common = next((each for each in self._ancestors(frame.lstrip("/")) if each in above), None)
        if common is None:
            return None
        (position, turn), (origin, axes) = (self._in_ancestor(each.lstrip("/"), common) for each in (frame, target))
        rotation: FloatArray = (axes.inv() * turn).as_quat()
        return axes.inv().apply(position - origin), rotation

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on.

        Raises
        ------
        InputError
            When there is no end of them.
        """
        frames = [frame]
        while frame in self._parents:
            frame = self._parents[frame].parent.lstrip("/")
            if frame in frames:
                raise InputError(f"the transforms of tf lead from {frame} back to {frame}")
            frames.append(frame)
        return frames

    def _in_ancestor(self, frame: str, ancestor: str) -> "tuple[FloatArray, Rotation]":
        """Return where a frame is in one of its ancestors."""
        from scipy.spatial.transform import Rotation

        position, rotation = np.zeros(3), Rotation.identity()
        while frame != ancestor:
            transform = self._parents[frame]
            try:
                turn = Rotation.from_quat(transform.rotation)
            except ValueError:
                raise InputError(f"the rotation of {frame} in {transform.parent} is not a valid one in tf") from None
            position, rotation = turn.apply(position) + transform.position_m, turn * rotation
            frame = transform.parent.lstrip("/")
        return position, rotation
