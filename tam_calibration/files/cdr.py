"""The serialised messages of ROS 2 (CDR) whose stamp and numbers are read and filled in without building objects."""

import struct
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray

_BODY = 4
"""Bytes before the message, which tell the byte order; alignment counts from here."""

_PLAIN_CDR = {b"\x00\x00": ">", b"\x00\x01": "<"}


class StampedDoubles:
    """Reads messages that are a header and then, first of all, doubles: MagneticField, Imu, Temperature.

    Parameters
    ----------
    count : int
        Number of doubles to read.
    """

    def __init__(self, count: int) -> None:
        self._layouts = {
            kind: (struct.Struct(f"{order}iII"), struct.Struct(f"{order}{count}d"))
            for kind, order in _PLAIN_CDR.items()
        }

    def read(self, message: bytes) -> tuple[int, tuple[float, ...]]:
        """Return stamp in nanoseconds and the doubles.

        Raises
        ------
        InputError
            When the message is truncated or not plain CDR.
        """
        try:
            header, doubles = self._layouts[bytes(message[:2])]
            seconds, nanoseconds, length = header.unpack_from(message, _BODY)
            start = _BODY + _align(header.size + length)
            return seconds * 1_000_000_000 + nanoseconds, doubles.unpack_from(message, start)
        except (KeyError, struct.error):
            raise InputError("a message is damaged: it is too short, or not in the serialisation CDR") from None


def read_float64(message: bytes) -> tuple[None, tuple[float, ...]]:
    """Return the number of a ``std_msgs/Float64``; it has no stamp.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    try:
        return None, struct.unpack_from(f"{_PLAIN_CDR[bytes(message[:2])]}d", message, _BODY)
    except (KeyError, struct.error):
        raise InputError("a message is damaged: it is too short, or not in the serialisation CDR") from None


def fill(template: bytes, from_end: int, values: FloatArray, stamps_ns: NDArray[np.int64] | None) -> Iterator[bytes]:
    """Yield copies of a serialised message (little-endian) with other numbers and stamps.

    Parameters
    ----------
    template : bytes
        Serialised message.
    from_end : int
        Bytes from the first double that changes to the end of the message.
    values : (N, n) array
        Doubles of each message.
    stamps_ns : (N,) array, optional
        Stamps of the header; None for a message without.
    """
    copies = np.tile(np.frombuffer(template, np.uint8), (len(values), 1))
    start = len(template) - from_end
    copies[:, start : start + 8 * values.shape[1]] = np.ascontiguousarray(values, "<f8").view(np.uint8)
    if stamps_ns is not None:
        seconds, nanoseconds = np.divmod(stamps_ns, 1_000_000_000)
        stamp = np.column_stack([seconds.astype("<i4"), nanoseconds.astype("<i4")])
        copies[:, _BODY : _BODY + 8] = np.ascontiguousarray(stamp).view(np.uint8)
    return (copy.tobytes() for copy in copies)


def _align(size: int) -> int:
    return (size + 7) & -8
