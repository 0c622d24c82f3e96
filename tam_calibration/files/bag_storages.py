"""The storages of bags: each is one module that reads and writes its files, and one line in ``STORAGES``."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from tam_calibration.messages.cdr import RawMessages


class StoredFile(Protocol):
    """A file of a bag as its reader opens it: those of rosbags, or one with their attributes."""

    path: Any
    connections: Sequence[Any]
    metadata: Any

    def messages(self, connections: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, time of recording in nanoseconds and serialised message, in the order of recording."""


class Storage(Protocol):
    """What the module of a storage holds.

    Attributes
    ----------
    READER : type of StoredFile
        Opens a file by its path, as ``rosbags.rosbag2.reader`` asks of a plugin.
    WRITER : type
        Writes a file, as ``rosbags.rosbag2.Writer`` asks of a plugin; beside that ``write_block(messages)`` writes
        ``RawMessages``.
    """

    READER: type[Any]
    WRITER: type[Any]

    def read_blocks(
        self, file: StoredFile, position: Mapping[int, int], with_times: bool
    ) -> Iterator[tuple[RawMessages, int]] | None:
        """Return the messages of some connections many at once, and the bytes read for them, in the order of recording.

        None where the file lacks what that needs, such as an index: its messages are then read one by one.

        Parameters
        ----------
        file : StoredFile
            Opened by ``READER``.
        position : mapping of int to int
            For the id of each connection that is read the number that stands for it in the messages.
        with_times : bool
            Whether the times of recording are wanted; without them they may be ``NOT_READ``.
        """


@dataclass(frozen=True)
class RegisteredStorage:
    """A storage, without the libraries that it needs.

    Parameters
    ----------
    name : str
        In ``metadata.yaml``, and for the user.
    suffix : str
        Of its files.
    beginning : bytes
        With which its files begin.
    module : str
        That holds it.
    stands_alone : bool
        Whether a single file is written where its suffix is asked for, instead of a folder.
    """

    name: str
    suffix: str
    beginning: bytes
    module: str
    stands_alone: bool = False

    def load(self) -> Storage:
        """Return what reads and writes the files."""
        return cast(Storage, import_module(self.module))


STORAGES = {
    storage.name: storage
    for storage in (
        RegisteredStorage("sqlite3", ".db3", b"SQLite format 3\0", "tam_calibration.files.bag_sqlite3"),
        RegisteredStorage("mcap", ".mcap", b"\x89MCAP0\r\n", "tam_calibration.files.bag_mcap", stands_alone=True),
    )
}
"""By their names; the first is what a bag's folder holds where nothing else is asked for."""

DEFAULT = next(iter(STORAGES))


def storage_of(path: Path) -> str:
    """Return the name of the storage of a bag, a folder or a single file."""
    for storage in STORAGES.values():
        if path.suffix == storage.suffix or any(path.glob(f"*{storage.suffix}*")):
            return storage.name
    return DEFAULT


def storage_alone(path: Path) -> RegisteredStorage | None:
    """Return the storage of which a single file is written at a path; None where a folder is."""
    alone = (each for each in STORAGES.values() if each.stands_alone and path.suffix == each.suffix)
    return next(alone, None)
