"""Opens bags: what tells them from other files needs no library."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tam_calibration.model.libraries import require
from tam_calibration.recordings.bag_storages import is_bag
from tam_calibration.recordings.channel_map import ChannelMap
from tam_calibration.recordings.tables import Source


class BagFormat:
    """Bags of ROS 2 and ROS 1."""

    def recognises(self, path: Path, beginning: bytes) -> bool:
        """Return whether a file begins as a bag does, or a folder contains one."""
        return is_bag(path)

    @contextmanager
    def open(self, path: Path, channel_map: ChannelMap | None) -> Iterator[Source]:
        """Open a bag; the map tells nothing of how its files are read."""
        require("bags", "reading bags")
        from tam_calibration.recordings.bag_reader import open_bag
        from tam_calibration.recordings.bag_source import BagSource

        with open_bag(path) as bag:
            yield BagSource(bag)
