"""Messages that are published as serialised bytes: a template is made once, stamps and numbers are filled in."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from rclpy.publisher import Publisher
from rclpy.serialization import serialize_message

from tam_calibration.files.cdr import fill
from tam_calibration.pointcloud_layout import FLOAT64_SIZE
from tam_calibration.stream_batch import IntArray
from tam_calibration.units import FloatArray


@dataclass(frozen=True)
class MessageWriter:
    """Serialises messages that differ in the stamp of their header and in some doubles alone.

    Parameters
    ----------
    template : bytes
        Such a message, serialised.
    from_end : int
        Bytes from the first of these doubles to its end.
    """

    template: bytes
    from_end: int

    @classmethod
    def of(cls, message: Any, doubles: int) -> "MessageWriter":
        """Return the writer of messages like this one whose last doubles, so many, differ."""
        return cls(bytes(serialize_message(message)), FLOAT64_SIZE * doubles)

    def messages(self, values: FloatArray, stamps_ns: IntArray | None) -> Sequence[bytes]:
        """Return a message for each row of (N, doubles) values and its stamp in nanoseconds; None: it has no header."""
        return list(map(bytes, fill(self.template, self.from_end, values, stamps_ns)))


def publish(publisher: Publisher, messages: Sequence[bytes]) -> None:
    """Publish serialised messages."""
    for message in messages:
        publisher.publish(message)
