"""Many serialised messages at once, as they lie one after another in a block of bytes."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

IntArray = NDArray[np.int64]
ByteArray = NDArray[np.uint8]

NOT_READ = -1
"""A time of recording that was not read."""


@dataclass(frozen=True, eq=False)
class RawMessages:
    """Serialised messages in the order of their recording.

    Parameters
    ----------
    connection : (n,) array of int
        Which of the connections that were asked for each is of.
    recorded_ns : (n,) array of int
        Times of recording, nanoseconds; ``NOT_READ`` where nobody asked for them.
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
        """Return single messages as one block."""
        size = np.array([len(message) for message in messages], dtype=np.int64)
        block = np.frombuffer(b"".join(messages), np.uint8)
        return cls(np.array(connection), np.array(recorded_ns), np.cumsum(size) - size, size, block)

    @classmethod
    def of_rows(cls, connection: int, recorded_ns: IntArray, rows: ByteArray) -> "RawMessages":
        """Return the (n, bytes) messages of one connection."""
        count, size = rows.shape
        start = np.arange(count) * size
        return cls(np.full(count, connection), recorded_ns, start, np.full(count, size), rows.ravel())

    def __len__(self) -> int:
        """Return the number of messages."""
        return len(self.start)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_] | slice) -> "RawMessages":
        """Return the messages that a mask, slice or index selects, in the same block."""
        chosen = {name: getattr(self, name)[index] for name in ("connection", "recorded_ns", "start", "size")}
        return replace(self, **chosen)

    def messages(self) -> list[bytes]:
        """Return the messages one by one."""
        block = self.block.tobytes()
        ends = (self.start + self.size).tolist()
        return [block[start:end] for start, end in zip(self.start.tolist(), ends, strict=True)]


def join(parts: Sequence[RawMessages]) -> RawMessages:
    """Return several as one, one after another."""
    if len(parts) == 1:
        return parts[0]
    shift = np.cumsum([0, *(len(part.block) for part in parts)])
    start = [part.start + moved for part, moved in zip(parts, shift, strict=False)]
    others = [[getattr(part, name) for part in parts] for name in ("connection", "recorded_ns", "size", "block")]
    connection, recorded_ns, size, block = (np.concatenate(each) for each in others)
    return RawMessages(connection, recorded_ns, np.concatenate(start), size, block)


def windows(block: ByteArray, size: int) -> NDArray[np.void]:
    """Return the bytes from each place of a block on as one item, without a copy: made to be indexed."""
    return np.ndarray(max(len(block) - size + 1, 0), f"V{size}", block, strides=(1,))


def interleave(parts: Sequence[RawMessages], places: Sequence[IntArray]) -> RawMessages:
    """Return several as one in the order of the places of their messages; at equal places in the order of the parts."""
    return join(parts).take(np.argsort(np.concatenate(places), kind="stable"))
