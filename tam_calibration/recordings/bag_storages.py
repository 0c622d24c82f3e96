"""The storages of bags, and the folder of a bag: its metadata, and the files that hold its messages.

A storage is one module that reads, and mostly writes, its files, and one line in ``STORAGES``.
"""

import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np

from tam_calibration.files.text_files import read_text, require_regular
from tam_calibration.files.yaml_document import parse_mapping
from tam_calibration.messages.cdr import RawMessages, gather
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import IntArray

if TYPE_CHECKING:
    from rosbags.interfaces import Connection

READABLE = ("cdr", "ros1")
"""How messages that are read are serialised, as bags name it: by ROS 2, or by ROS 1."""


def serialisation_of(connection: "Connection") -> str:
    """Return how the messages of a topic are serialised; ``READABLE`` has those that are read."""
    return str(getattr(connection.ext, "serialization_format", ""))


def numbers_of(position: Mapping[int, int]) -> IntArray:
    """Return the numbers of connections in messages, at the places of their ids."""
    numbers = np.zeros(max(position) + 1, dtype=np.int64)
    numbers[list(position)] = list(position.values())
    return numbers


class Condition(Enum):
    """How a file was left."""

    COMPLETE = auto()
    UNFINISHED = auto()
    """Its recorder did not end it, or it was cut."""
    NOT_INDEXED = auto()
    """It is finished, but lacks the index that reading needs."""


class StoredFile:
    """A file of a bag whose messages can be read; the class of a storage is made of its path.

    Parameters
    ----------
    path : Path
        The file.
    connections : sequence of Connection
        Its topics as rosbags describes them, with their numbers of messages. ``ext.serialization_format`` is ``cdr``,
        ``ros1``, or one that is not read; ``msgdef`` is the definition of the type, where the file contains one.
    start_ns, end_ns : int
        When the first and the last message were recorded, nanoseconds.
    """

    def __init__(self, path: Path, connections: Sequence["Connection"], start_ns: int, end_ns: int) -> None:
        self.path, self.connections, self.start_ns, self.end_ns = path, connections, start_ns, end_ns
        self.message_count = sum(one.msgcount for one in connections)

    def messages(self, ids: Collection[int]) -> Iterator[tuple[int, int, bytes]]:
        """Yield the id of the connection, the time of recording and the serialised message of some connections.

        Parameters
        ----------
        ids : collection of int
            Those of the connections.
        """
        raise NotImplementedError

    def blocks(self, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
        """Yield the messages of some connections in the order of recording, many at once, and the bytes read for them.

        Parameters
        ----------
        position : mapping of int to int
            For the id of each connection that is read its number in the messages.
        """
        wanted = ((position[number], recorded_ns, content) for number, recorded_ns, content in self.messages(position))
        for block, size in gather(wanted, self.path.stat().st_size / self.message_count):
            yield block.in_order(), size


class Storage(Protocol):
    """What the module of a storage contains.

    Attributes
    ----------
    FILE : type of StoredFile
        Reads a complete file, and is made of its path.
    WRITER : type
        Writes a file, as ``rosbags.rosbag2.Writer`` asks of a plugin, and takes many messages at once by
        ``write_block``. A storage that is only read has none.
    """

    FILE: type[Any]
    WRITER: type[Any]

    def condition_of(self, path: Path) -> Condition:
        """Return how a file was left.

        Raises
        ------
        Damaged
            When it is finished, and not what was written.
        """

    def complete_messages(self, path: Path, faults: list[str]) -> Iterator[tuple["Connection", int, bytes]]:
        """Yield connection, time of recording and serialised message of all that is complete, in the order of writing.

        Parameters
        ----------
        path : Path
            The file, in whatever condition; it is never written to.
        faults : list of str
            Each part that is left out though something follows it is added, as a clause.
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
        That implements it: a `Storage`.
    stands_alone : bool
        Whether a single file is written where its suffix is asked for, instead of a folder.
    is_written : bool
        Whether bags are written in it.
    """

    name: str
    suffix: str
    beginning: bytes
    module: str
    stands_alone: bool = False
    is_written: bool = True

    def load(self) -> Storage:
        """Return the module."""
        return cast(Storage, import_module(self.module))


STORAGES = {
    storage.name: storage
    for storage in (
        RegisteredStorage("sqlite3", ".db3", b"SQLite format 3\0", "tam_calibration.recordings.bag_sqlite3"),
        RegisteredStorage("mcap", ".mcap", b"\x89MCAP0\r\n", "tam_calibration.recordings.bag_mcap", stands_alone=True),
        RegisteredStorage("ros1", ".bag", b"#ROSBAG V2.0", "tam_calibration.recordings.bag_ros1", is_written=False),
    )
}
"""By their names; the first is what a bag's folder contains where nothing else is asked for."""

_BEGINNINGS = tuple(storage.beginning for storage in STORAGES.values())
_SUFFIXES = tuple(storage.suffix for storage in STORAGES.values())

DEFAULT = next(iter(STORAGES))


def written() -> dict[str, RegisteredStorage]:
    """Return the storages in which bags are written, by their names."""
    return {name: storage for name, storage in STORAGES.items() if storage.is_written}


def storage_of(path: Path) -> str:
    """Return the name of the storage in which a bag is written anew: its own, if bags are written in that."""
    for storage in written().values():
        if path.suffix == storage.suffix or any(path.glob(f"*{storage.suffix}*")):
            return storage.name
    return DEFAULT


def storage_for(file: Path) -> Storage:
    """Return the module that reads a file of a bag, by how it begins, else by its suffix.

    Raises
    ------
    InputError
        When it is of no storage.
    """
    with file.open("rb") as stream:
        beginning = stream.read(16)

    def likeness(storage: RegisteredStorage) -> int:
        return 2 * beginning.startswith(storage.beginning) + (file.suffix == storage.suffix)

    found = max(STORAGES.values(), key=likeness)
    if not likeness(found):
        raise InputError(f"{file.name} is of no storage that is known: {', '.join(STORAGES)}")
    return found.load()


def storage_alone(path: Path) -> RegisteredStorage | None:
    """Return the storage of which a single file is written at a path; None where a folder is."""
    alone = (each for each in STORAGES.values() if each.stands_alone and path.suffix == each.suffix)
    return next(alone, None)


def is_bag(path: Path) -> bool:
    """Return whether a path that exists is a bag, by its content.

    Raises
    ------
    InputError
        When there is nothing at the path, or neither a regular file nor a folder.
    """
    if not os.path.lexists(path):
        raise InputError(f"there is no file or bag {path}")
    require_regular(path)
    if path.is_dir():
        names = [part.name for part in path.iterdir()]
        return METADATA in names or not names or any(suffix in name for name in names for suffix in _SUFFIXES)
    if path.suffix in _SUFFIXES:
        return True
    with path.open("rb") as file:
        return file.read(16).startswith(_BEGINNINGS)


METADATA = "metadata.yaml"

PACKED = ".zstd"
"""Suffix behind that of a packed file."""


@dataclass(frozen=True)
class Metadata:
    """The part of a bag's metadata that its files do not tell, the same in all versions since Foxy.

    Parameters
    ----------
    files : tuple of str
        Names of the data files, in their order.
    topics : dict of str to (int, str)
        Number of the messages of each topic, and how they are serialised.
    """

    files: tuple[str, ...]
    topics: dict[str, tuple[int, str]]


def read_metadata(folder: Path) -> Metadata | None:
    """Return the metadata of a bag; None where the recorder did not write them to their end, or they are damaged."""
    try:
        information = parse_mapping(read_text(folder / METADATA))["rosbag2_bagfile_information"]
        files = dict.fromkeys(Path(str(path)).name for path in information["relative_file_paths"])
        topics = {}
        for each in information["topics_with_message_count"]:
            topic = each["topic_metadata"]
            topics[str(topic["name"])] = each["message_count"], str(topic["serialization_format"])
        return Metadata(tuple(files), topics)
    except (InputError, LookupError, TypeError):
        return None


def data_files(path: Path) -> list[Path]:
    """Return the files that hold the messages of a bag, in their order; a single file is its own.

    Raises
    ------
    InputError
        When the path is no bag.
    """
    if not path.is_dir():
        return [path]
    metadata = read_metadata(path)
    files = _found_in(path) if metadata is None else [path / name for name in metadata.files]
    for file in files:
        if file.is_dir():
            raise InputError(f"{file} is a folder, not a file of a bag")
    return files


def _found_in(folder: Path) -> list[Path]:
    """Return the files that a recorder left without metadata, by the numbers in their names."""
    files = [each for each in folder.iterdir() if each.name.removesuffix(PACKED).endswith(_SUFFIXES)]
    names = {each.name for each in files}
    # The recorder writes the packed file next to the original, which it then removes.
    files = [each for each in files if each.name == each.name.removesuffix(PACKED) or each.stem not in names]
    if not files:
        kinds = " or ".join(_SUFFIXES)
        raise InputError(f"{folder} contains no {METADATA}, nor a file that ends in {kinds}: is it a bag?")
    if len(recordings := sorted({re.sub(r"_\d+$", "", each.name.partition(".")[0]) for each in files})) > 1:
        raise InputError(
            f"{folder} contains no {METADATA}, but files of several recordings, {recordings[0]} and {recordings[1]} "
            "among them: name one of them"
        )
    return sorted(files, key=_in_order)


def _in_order(path: Path) -> list[tuple[str, int]]:
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)]
