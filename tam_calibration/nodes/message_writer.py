"""Messages that are published as serialised bytes: all but stamp and numbers is serialised once.

Filling in one is far cheaper than making and serialising a message object. Byte order is little-endian, as on all
platforms of ROS 2.
"""

import struct
from dataclasses import dataclass
from typing import Any

from rclpy.serialization import serialize_message

from tam_calibration.pointcloud_layout import FLOAT64_SIZE

STAMP = slice(4, 12)
"""Where a serialised message has the stamp of its header."""

_STAMP = struct.Struct("<iI")


@dataclass(frozen=True)
class MessageWriter:
    """Serialises messages that differ in the stamp of their header and in some doubles alone.

    Parameters
    ----------
    before_stamp, before_doubles, after_doubles : bytes
        What such a message has before its stamp, from there to its doubles, and behind them.
    """

    before_stamp: bytes
    before_doubles: bytes
    after_doubles: bytes

    @classmethod
    def of(cls, message: Any, doubles: int) -> "MessageWriter":
        """Return the writer of messages like this one, with a header, whose last doubles, so many, differ."""
        template = serialize_message(message)
        return cls.of_template(template, len(template) - FLOAT64_SIZE * doubles, doubles)

    @classmethod
    def of_template(cls, template: bytes, start: int, doubles: int) -> "MessageWriter":
        """Return the writer of messages like a serialised one whose doubles, so many, begin at a place in it."""
        return cls(template[: STAMP.start], template[STAMP.stop : start], template[start + FLOAT64_SIZE * doubles :])

    @classmethod
    def of_unstamped(cls, message: Any, doubles: int) -> "MessageWriter":
        """Return the writer of messages like this one, without a header, whose last doubles, so many, differ."""
        return cls(serialize_message(message)[: -FLOAT64_SIZE * doubles], b"", b"")

    def message(self, stamp: bytes, doubles: bytes) -> bytes:
        """Return a serialised message with a stamp, empty for one without header, and doubles."""
        return b"".join((self.before_stamp, stamp, self.before_doubles, doubles, self.after_doubles))


def to_stamp(stamp_ns: int) -> bytes:
    """Return a stamp as it is in messages."""
    return _STAMP.pack(*divmod(stamp_ns, 1_000_000_000))


def from_stamp(stamp: bytes) -> int:
    """Return a stamp of a message in nanoseconds."""
    seconds, nanoseconds = _STAMP.unpack(stamp)
    return int(seconds * 1_000_000_000 + nanoseconds)
