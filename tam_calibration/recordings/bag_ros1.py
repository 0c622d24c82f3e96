"""The storage of ROS 1, ``.bag``, which is only read."""

from bz2 import decompress as decompress_bz2
from collections.abc import Collection, Iterator
from functools import partial
from pathlib import Path

from lz4.frame import decompress as decompress_lz4
from rosbags.interfaces import Connection, ConnectionExtRosbag2
from rosbags.rosbag1 import Reader

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_bounds import reason_of, unpack_bounded
from tam_calibration.recordings.bag_storages import Condition, StoredFile

_COMPRESSIONS = {decompress_bz2: "bz2", decompress_lz4: "lz4"}
"""By the functions that rosbags would unpack chunks with, whatever comes of them."""


class Ros1File(StoredFile):
    """A ROS 1 bag with an index; its messages are serialised as ``ros1``.

    Parameters
    ----------
    path : Path
        The file.
    """

    def __init__(self, path: Path) -> None:
        try:
            with Reader(path) as reader:
                connections = [one._replace(ext=ConnectionExtRosbag2("ros1", [])) for one in reader.connections]
                super().__init__(path, connections, reader.start_time, reader.end_time - 1)
        except Exception as problem:  # rosbags asserts some parts of an index
            reason = reason_of(problem).rstrip(".")
            raise InputError(f"{reason}; `rosbag reindex {path.name}` repairs a missing index") from problem

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield messages in the order of recording, as of `StoredFile`, of chunks that are unpacked within bounds."""
        with Reader(self.path) as reader:
            for place, chunk in reader.chunks.items():
                if compression := _COMPRESSIONS.get(chunk.decompressor):
                    unpack = partial(unpack_bounded, compression=compression, what="a chunk")
                    reader.chunks[place] = chunk._replace(decompressor=unpack)
            for one, recorded_ns, raw in reader.messages([one for one in self.connections if one.id in ids]):
                yield one.id, recorded_ns, bytes(raw)


def condition_of(path: Path) -> Condition:
    """Return how a file was left, as of `RegisteredStorage`: opening it tells more."""
    return Condition.COMPLETE


def complete_messages(path: Path, faults: list[str]) -> Iterator[tuple[Connection, int, bytes]]:
    """Refuse to recover a bag of ROS 1, for which `rosbag reindex` exists."""
    raise InputError(f"it is a bag of ROS 1: `rosbag reindex {path.name}` repairs a missing index")


FILE = Ros1File
