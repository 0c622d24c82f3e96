"""The storages of bags: each is one module that reads and writes its files, and one line in ``STORAGES``."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

from tam_calibration.messages.cdr import RawMessages
from tam_calibration.model.exceptions import InputError


class StoredFile(Protocol):
    """A file of a bag as its reader opens it: those of rosbags, or one with their attributes."""

    path: Any
    connections: Sequence[Any]
    metadata: Any

    def messages(self, connections: Sequence[Any]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, time of recording in nanoseconds and serialised message, in the order of recording."""


class Guard(Protocol):
    """Tells of a file whether it is finished and whole; made of its path, and writes to nothing."""

    def is_unfinished(self) -> bool:
        """Return whether its recorder did not end it, or it was cut."""

    def find_damage(self) -> str:
        """Return what is damaged, as a clause; nothing where the file tells of none."""

    def damaged_messages(self) -> str:
        """Return a clause that names the damaged messages; nothing where no message is."""

    def whole_messages(self, faults: list[str]) -> Iterator[tuple[Any, int, bytes]]:
        """Yield connection, time of recording and serialised message of all that is whole, in the order of writing.

        Parameters
        ----------
        faults : list of str
            What was left out, though something stands behind it, is added to it.
        """


class Storage(Protocol):
    """What the module of a storage holds.

    Attributes
    ----------
    READER : type of StoredFile
        Opens a file by its path, as ``rosbags.rosbag2.reader`` asks of a plugin.
    WRITER : type
        Writes a file, as ``rosbags.rosbag2.Writer`` asks of a plugin; beside that ``write_block(messages)`` writes
        ``RawMessages``.
    GUARD : callable
        Makes the `Guard` of a file of its path.
    """

    READER: type[Any]
    WRITER: type[Any]
    GUARD: Callable[[Path], Guard]

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


def guard_of(file: Path) -> Guard:
    """Return the guard of a file of a bag, by its suffix, else by how it begins.

    Raises
    ------
    InputError
        When it is of no storage.
    """
    for storage in STORAGES.values():
        if file.suffix == storage.suffix:
            return storage.load().GUARD(file)
    with file.open("rb") as stream:
        beginning = stream.read(16)
    for storage in STORAGES.values():
        if beginning.startswith(storage.beginning):
            return storage.load().GUARD(file)
    raise InputError(f"{file} is of no storage that is known: {', '.join(STORAGES)}")


def storage_alone(path: Path) -> RegisteredStorage | None:
    """Return the storage of which a single file is written at a path; None where a folder is."""
    alone = (each for each in STORAGES.values() if each.stands_alone and path.suffix == each.suffix)
    return next(alone, None)
