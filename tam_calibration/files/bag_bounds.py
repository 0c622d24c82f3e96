"""Bounds for what is packed in a bag: looked at before it is unpacked, and while it is."""

from pathlib import Path

from lz4.frame import LZ4FrameDecompressor
from zstandard import ZstdDecompressor

from tam_calibration.model.exceptions import InputError

LARGEST_PIECE = 1 << 28
"""Bytes that a chunk, a message or a block of messages may have, 256 MiB: recorders write chunks of 1 to 8 MiB."""

LARGEST_EXPANSION = 1000
"""Bytes that may come of one packed byte: readings give less than 20, zeros 30 000."""

_ALWAYS_ALLOWED = 1 << 20
"""Bytes that may come of any piece, 1 MiB, as many as a usual chunk has."""

LARGEST_TOPIC = 1 << 16
"""Bytes that the description of a topic may have, 64 KiB: the quality of service of a publisher takes some 500."""

_BLOCK = 1 << 17
"""Bytes that are unpacked at once, 128 KiB as zstd does: more would be lost where a later one of them is damaged."""

ZSTD_BEGINNING = b"\x28\xb5\x2f\xfd"
"""With which a frame of zstd begins, and no serialised message."""


def check_expansion(packed: int, unpacked: int, what: str) -> None:
    """Check that no more comes of something packed than of a recording.

    Parameters
    ----------
    packed, unpacked : int
        Bytes as it is stored, and that it claims or turned out to hold.
    what : str
        The subject of the sentence.

    Raises
    ------
    InputError
        When it is more.
    """
    if unpacked > max(_ALWAYS_ALLOWED, LARGEST_EXPANSION * packed):
        raise InputError(
            f"{what} of {packed} bytes holds {unpacked} bytes or more: of a recording not even {LARGEST_EXPANSION} "
            "bytes come of one"
        )


def check_piece(packed: int, unpacked: int, what: str) -> None:
    """Check `check_expansion`, and that a piece is none that has no place in memory.

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
        raise InputError(f"{what} holds {unpacked} bytes: more than {LARGEST_PIECE} are not read")
    check_expansion(packed, unpacked, what)


def check_topic(size: int) -> None:
    """Check that a topic, whose description is parsed as YAML, is not described at length.

    Raises
    ------
    InputError
        When its description is larger than ``LARGEST_TOPIC``.
    """
    if size > LARGEST_TOPIC:
        raise InputError(f"a topic is described by {size} bytes: more than {LARGEST_TOPIC} are not read")


def unpack(packed: bytes, compression: str, size: int) -> bytes:
    """Return what a chunk holds.

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
        raise InputError(f"a chunk does not hold the {size} bytes that it claims")
    return content


def unpack_beginning(packed: bytes, compression: str, most: int) -> bytes:
    """Return at most so many bytes of what a chunk holds, fewer where it was cut.

    Parameters
    ----------
    packed : bytes
        As it is stored, or its beginning.
    compression : str
        ``zstd``, ``lz4`` or nothing.
    most : int
        Bytes to return at most.

    Raises
    ------
    InputError
        When the compression is not known.
    """
    content: bytes
    match compression:
        case "":
            content = packed[:most]
        case "zstd":
            content = ZstdDecompressor().stream_reader(packed, read_across_frames=True).read(most)
        case "lz4":
            content = LZ4FrameDecompressor().decompress(packed, max_length=most)
        case _:
            raise InputError(f"the compression {compression!r} of a chunk is not known: zstd and lz4 are")
    return content


def unpack_message(packed: bytes) -> bytes:
    """Return a message that was packed by itself.

    Raises
    ------
    InputError
        When it is larger than it may be.
    """
    most = max(_ALWAYS_ALLOWED, min(LARGEST_PIECE, LARGEST_EXPANSION * len(packed)))
    content = unpack_beginning(packed, "zstd", most + 1)
    check_piece(len(packed), len(content), "a message")
    return content


def unpack_file(source: Path, target: Path) -> None:
    """Write what a file that was packed by zstd holds, as far as it goes where it was cut.

    Raises
    ------
    InputError
        When too much comes of it.
    """
    packed, unpacked = source.stat().st_size, 0
    with source.open("rb") as stored, target.open("wb") as file:
        stream = ZstdDecompressor().stream_reader(stored, read_across_frames=True)
        while block := stream.read(_BLOCK):
            unpacked += len(block)
            check_expansion(packed, unpacked, source.name)
            file.write(block)
