"""The serialised messages of ROS 2 (CDR) whose stamp and numbers are read and filled in without building objects."""

import struct
from collections.abc import Iterator
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from tam_calibration.exceptions import InputError
from tam_calibration.files.raw_messages import ByteArray, IntArray, RawMessages, windows
from tam_calibration.units import FloatArray

_BODY = 4
"""Bytes before the message, which tell the byte order; alignment counts from here."""

ByteOrder = Literal["<", ">"]

_KINDS: dict[ByteOrder, int] = {"<": 0x0100, ">": 0x0000}
"""The first two bytes by byte order, read as a little-endian number."""

_HEAD = np.dtype([("seconds", "i4"), ("nanoseconds", "u4"), ("length", "u4")])
"""Stamp, and length of the frame's name."""

_HEADS = {_KINDS[order].to_bytes(2, "little"): (order, struct.Struct(f"{order}iII")) for order in _KINDS}
"""Byte order and head by the first two bytes of a message."""

_DAMAGED = "a message is damaged: it is too short, or not in the serialisation CDR"


def read_stamped_doubles(messages: RawMessages, count: int) -> tuple[IntArray, FloatArray]:
    """Return the (n,) stamps in nanoseconds and the (n, count) doubles of messages that begin with header and doubles.

    Raises
    ------
    InputError
        When a message is truncated or not plain CDR.
    """
    stamps, values = np.empty(len(messages), dtype=np.int64), np.empty((len(messages), count))
    for chosen, part, order in _by_byte_order(messages):
        head = _take(part, _BODY, _HEAD.itemsize).view(_HEAD.newbyteorder(order))
        stamps[chosen] = head["seconds"].astype(np.int64) * 1_000_000_000 + head["nanoseconds"]
        begin = _BODY + (_HEAD.itemsize + head["length"].astype(np.int64) + 7 & -8)
        values[chosen] = _take(part, begin, 8 * count).view(f"{order}f8").reshape(-1, count)
    return stamps, values


def read_float64s(messages: RawMessages) -> tuple[None, FloatArray]:
    """Return the (n, 1) numbers of messages ``std_msgs/Float64``; they have no stamps.

    Raises
    ------
    InputError
        When a message is truncated or not plain CDR.
    """
    values = np.empty((len(messages), 1))
    for chosen, part, order in _by_byte_order(messages):
        values[chosen, 0] = _take(part, _BODY, 8).view(f"{order}f8")
    return None, values


def read_stamp_and_doubles(message: bytes, count: int) -> tuple[int, tuple[float, ...]]:
    """Return stamp and doubles of one message: as ``read_stamped_doubles``, faster for a single one.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    try:
        order, head = _HEADS[message[:2]]
        seconds, nanoseconds, length = head.unpack_from(message, _BODY)
        begin = _BODY + (head.size + length + 7 & -8)
        return seconds * 1_000_000_000 + nanoseconds, struct.unpack_from(f"{order}{count}d", message, begin)
    except (KeyError, struct.error):
        raise InputError(_DAMAGED) from None


def read_float64(message: bytes) -> float:
    """Return the number of one message ``std_msgs/Float64``.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    try:
        value: float = struct.unpack_from(f"{_HEADS[message[:2]][0]}d", message, _BODY)[0]
    except (KeyError, struct.error):
        raise InputError(_DAMAGED) from None
    return value


def _by_byte_order(messages: RawMessages) -> Iterator[tuple[slice | NDArray[np.bool_], RawMessages, ByteOrder]]:
    kinds = _take(messages, 0, 2).view("<u2")
    for order, kind in _KINDS.items():
        chosen = kinds == kind
        if chosen.all():
            yield slice(None), messages, order
            return
        if chosen.any():
            yield chosen, messages.take(chosen), order
    if not np.isin(kinds, list(_KINDS.values())).all():
        raise InputError(_DAMAGED)


def _take(messages: RawMessages, begin: IntArray | int, size: int) -> NDArray[Any]:
    """Return so many bytes of each message, from a place in each on."""
    if (begin + size > messages.size).any():
        raise InputError(_DAMAGED)
    taken: NDArray[Any] = windows(messages.block, size)[messages.start + begin]
    return taken


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
        copies[:, _BODY : _BODY + 8] = stamp.view(np.uint8)
    return copies
