"""Bounds for the content of a bag, checked before and during unpacking, and sentences for what is damaged."""

import errno
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lz4.frame import LZ4FrameDecompressor
from rosbags.interfaces import Qos
from rosbags.rosbag2.metadata import parse_qos
from zstandard import ZstdDecompressor

from tam_calibration.files.text_files import temporary_place
from tam_calibration.files.yaml_document import parse_mapping
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_storages import PACKED

LARGEST_PIECE = 1 << 28
"""Most bytes of a chunk, a message or a block of messages, 256 MiB: recorders write chunks of 1 to 8 MiB."""

LARGEST_EXPANSION = 1000
"""Most bytes that may come of one packed byte: readings give less than 20, zeros 30 000."""

_ALWAYS_ALLOWED = 1 << 20
"""Bytes that may come of any piece, 1 MiB, the size of a usual chunk."""

_LARGEST_QUALITY = 1 << 16
"""Most bytes of a topic's quality of service, 64 KiB: that of one publisher takes some 500."""

MOST_TOPICS = 4096
"""Most topics of a file: a large robot has some hundreds."""


def check_expansion(packed: int, unpacked: int, what: str) -> None:
    """Check that something packed does not hold more than a recording could.

    Parameters
    ----------
    packed, unpacked : int
        Bytes as it is stored, and that it claims or turned out to hold.
    what : str
        The subject of the sentence.

    Raises
    ------
    InputError
        When it contains more.
    """
    if unpacked > max(_ALWAYS_ALLOWED, LARGEST_EXPANSION * packed):
        raise InputError(
            f"{what} of {packed} bytes unpacks to {unpacked} bytes or more: no recording is compressed by more than a "
            f"factor of {LARGEST_EXPANSION}"
        )


def check_piece(packed: int, unpacked: int, what: str) -> None:
    """Check `check_expansion`, and that a piece has a place in memory.

    Parameters
    ----------
    packed, unpacked : int
        Bytes as it is stored, and that it claims to hold.
    what : str
        The subject of the sentence.

    Raises
    ------
    InputError
        When it is larger than ``LARGEST_PIECE``, or too much comes of it.
    """
    if unpacked > LARGEST_PIECE:
        raise InputError(f"{what} has {unpacked} bytes: more than {LARGEST_PIECE} are not read")
    check_expansion(packed, unpacked, what)


def check_topics(count: int) -> None:
    """Check that there are no more than ``MOST_TOPICS`` topics.

    Raises
    ------
    InputError
        When there are more.
    """
    if count > MOST_TOPICS:
        raise InputError(f"a file has {count} topics: more than {MOST_TOPICS} are not read")


def quality_of(text: str) -> list[Qos]:
    """Return the quality of service of a topic, which is YAML; nothing where it cannot be understood.

    Raises
    ------
    InputError
        When it is larger than 64 KiB.
    """
    if len(text) > _LARGEST_QUALITY:
        raise InputError(f"a topic is described by {len(text)} bytes: more than {_LARGEST_QUALITY} are not read")
    try:
        return parse_qos(parse_mapping("profiles:\n " + text.replace("\n", "\n "))["profiles"])
    except (InputError, LookupError, TypeError, AttributeError):
        return []


def unpack(packed: bytes, compression: str, size: int) -> bytes:
    """Return the content of a chunk.

    Parameters
    ----------
    packed : bytes
        As it is stored.
    compression : str
        ``zstd``, ``lz4`` or nothing.
    size : int
        Bytes that the chunk claims to hold.

    Raises
    ------
    InputError
        When it is larger than it may be, or not of that size.
    """
    check_piece(len(packed), size, "a chunk")
    content = unpack_beginning(packed, compression, size + 1)
    if len(content) != size:
        raise Damaged(f"a chunk does not hold the {size} bytes that it claims")
    return content


_UNPACKING: dict[str, Callable[[bytes, int], bytes]] = {
    "": lambda packed, most: packed[:most],
    "zstd": lambda packed, most: ZstdDecompressor().stream_reader(packed, read_across_frames=True).read(most),
    "lz4": lambda packed, most: LZ4FrameDecompressor().decompress(packed, max_length=most),
    "bz2": lambda packed, most: BZ2Decompressor().decompress(packed, max_length=most),
}
"""What returns at most so many bytes of what is packed, by the name of the compression."""


def unpack_beginning(packed: bytes, compression: str, most: int) -> bytes:
    """Return at most so many bytes of what is packed, fewer where it was cut.

    Parameters
    ----------
    packed : bytes
        As it is stored, or its beginning.
    compression : str
        ``zstd``, ``lz4``, ``bz2`` or nothing.
    most : int
        Bytes to return at most.

    Raises
    ------
    InputError
        When the compression is not known.
    """
    if compression not in _UNPACKING:
        raise InputError(f"the compression {compression!r} of a chunk is not known: zstd and lz4 are")
    return _UNPACKING[compression](packed, most)


def unpack_bounded(packed: bytes, compression: str, what: str) -> bytes:
    """Return something packed that does not tell its size.

    Parameters
    ----------
    packed : bytes
        As it is stored.
    compression : str
        ``zstd``, ``lz4`` or ``bz2``.
    what : str
        The subject of the sentence.

    Raises
    ------
    InputError
        When it is larger than it may be.
    """
    most = max(_ALWAYS_ALLOWED, min(LARGEST_PIECE, LARGEST_EXPANSION * len(packed)))
    content = unpack_beginning(packed, compression, most + 1)
    check_piece(len(packed), len(content), what)
    return content


def _unpack_file(source: Path, target: Path) -> None:
    """Write the content of a file that was packed by zstd, as far as it goes where it was cut."""
    packed, unpacked = source.stat().st_size, 0
    with source.open("rb") as stored, target.open("wb") as file:
        stream = ZstdDecompressor().stream_reader(stored, read_across_frames=True)
        # 128 KiB as in zstd: with larger blocks more would be lost before a damaged one.
        while block := stream.read(1 << 17):
            unpacked += len(block)
            check_expansion(packed, unpacked, source.name)
            file.write(block)


def unpacked(files: list[Path], folder: Path, faults: list[str] | None = None) -> list[Path]:
    """Return the files of a bag, packed ones unpacked into a folder.

    Parameters
    ----------
    files : list of Path
        As they are in the bag.
    folder : Path
        Where they are unpacked.
    faults : list of str, optional
        Takes a clause for each file that is damaged and unpacked in part; without it that is an error.
    """
    targets = []
    for file in files:
        target = folder / file.name.removesuffix(PACKED) if file.suffix == PACKED and file.exists() else file
        targets.append(target)
        if target == file:
            continue
        try:
            _unpack_file(file, target)
        except Exception as problem:
            if faults is None or (isinstance(problem, OSError) and problem.errno in NO_ROOM):
                raise
            faults.append(f"{file.name} cannot be unpacked to its end")
    return targets


NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
"""Error numbers of a disk without room: the input is not at fault."""


_TELLING = {"tam_calibration", "rosbags", "zstandard", "apsw"}
"""Packages whose exceptions are sentences for people."""


class Damaged(InputError):
    """A part of a bag is not what was written; other parts may be complete."""


@contextmanager
def damage_named(path: Path, may_recover: bool = True) -> Iterator[None]:
    """Turn whatever is wrong with the content of a bag into one sentence with the bag's name.

    Parameters
    ----------
    path : Path
        The bag.
    may_recover : bool
        Whether `tam recover` is advised.

    Raises
    ------
    InputError
        For every exception within; where a disk has no room for what is unpacked it says how to give some.
    """
    try:
        yield
    except Exception as problem:  # rosbags lets through whatever its decompressors and databases raise
        cause = problem if isinstance(problem, OSError) else problem.__cause__
        if isinstance(cause, OSError) and cause.errno in NO_ROOM:
            told = f"{path} cannot be unpacked or recovered in {temporary_place().parent}: {cause.strerror}"
            raise InputError(f"{told}; let TMPDIR name a folder with room") from cause
        if isinstance(problem, InputError) and not isinstance(problem, Damaged):
            raise InputError(f"{path} cannot be read: {problem}") from problem
        is_advised = may_recover and path.suffix != ".bag"
        advice = f"; `tam recover {path} -o NEW` keeps the complete messages" if is_advised else ""
        raise InputError(f"{path} is damaged or truncated: {reason_of(problem)}{advice}") from problem


def reason_of(problem: Exception) -> str:
    """Return what an exception says, unless it is one of Python itself."""
    if isinstance(problem, OSError) and problem.strerror:
        return problem.strerror
    is_telling = type(problem).__module__.partition(".")[0] in _TELLING
    return (" ".join(str(problem).split()) if is_telling else "") or "its parts do not fit together"
