"""The messages of a bag, many at once, whatever its storage."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.interfaces import Connection
from rosbags.rosbag2 import Reader
from rosbags.rosbag2.reader import DirectoryReader
from zstandard import BufferWithSegments, ZstdDecompressor, frame_content_size

from tam_calibration.files.bag_bounds import check_piece, unpack_message
from tam_calibration.files.bag_storages import STORAGES, RegisteredStorage, StoredFile
from tam_calibration.messages.cdr import RawMessages
from tam_calibration.messages.samples import Progress
from tam_calibration.model.exceptions import InputError

COUNT, _BYTES = 16_384, 8_000_000
"""How much is gathered where messages come one by one."""


def unnamed_topics(reader: Reader) -> list[str]:
    """Return the topics of the files of an open bag that its metadata do not name."""
    named = {each.topic for each in reader.connections}
    return sorted({own.topic for file in _files(reader) for own in file.connections} - named)


def read_blocks(
    reader: Reader, connections: Sequence[Connection], progress: Progress, with_times: bool
) -> Iterator[RawMessages]:
    """Yield the messages of some connections, many at once, in the order in which rosbags yields them.

    Parameters
    ----------
    reader : Reader
        An open bag.
    connections : sequence of Connection
        Those of its connections that are wanted.
    progress : callable
        Called with the bytes read so far, and how many there are.
    with_times : bool
        Whether the times of recording are wanted; without them some storages are read sooner.

    Raises
    ------
    InputError
        When the files lack a topic of which the metadata count messages, or something is larger than it may be.
    """
    files = _files(reader)
    for one in reader.connections:
        if one.msgcount and not any(_is_same(own, one) for file in files for own in file.connections):
            raise InputError(f"the metadata count {one.msgcount} messages of {one.topic}, which no file has as they do")
    total = sum(_bytes(file) for file in files)
    done = 0
    for block, size in _blocks(reader, files, connections, with_times):
        done = min(done + size, total)
        progress(done, total)
        yield block
    progress(total, total)


def _files(reader: Reader) -> Sequence[StoredFile]:
    storage: Any = reader.storage
    files: Sequence[StoredFile] = storage.storages if isinstance(reader.storage, DirectoryReader) else [storage]
    return files


def _bytes(file: StoredFile) -> int:
    return Path(str(file.path)).stat().st_size


def _blocks(
    reader: Reader, files: Sequence[StoredFile], connections: Sequence[Connection], with_times: bool
) -> Iterator[tuple[RawMessages, int]]:
    is_compressed = reader.compression_mode == "message"
    for file in files:
        for block, size in _stored_blocks(file, connections, with_times):
            yield _decompressed(block) if is_compressed else block, size


def _stored_blocks(
    file: StoredFile, connections: Sequence[Connection], with_times: bool
) -> Iterator[tuple[RawMessages, int]]:
    """Yield the messages of one file as they are stored."""
    wanted = [(own, one) for own in file.connections for one in connections if _is_same(own, one)]
    position = {own.id: connections.index(one) for own, one in wanted}
    if not position:
        return
    storage = next(each for each in map(RegisteredStorage.load, STORAGES.values()) if type(file) is each.READER)
    blocks = storage.read_blocks(file, position, with_times)
    if blocks is None:
        own = [connection for connection, _ in wanted]
        blocks = _gather(file.messages(own), position, _bytes(file) / file.metadata.message_count)
    yield from blocks


def _is_same(own: Connection, one: Connection) -> bool:
    """Return whether a connection of a file is one of the whole bag, as rosbags compares them."""
    is_same_kind = (own.topic, own.msgtype, own.ext) == (one.topic, one.msgtype, one.ext)
    return is_same_kind and (not own.digest or not one.digest or own.digest == one.digest)


def _decompressed(messages: RawMessages) -> RawMessages:
    """Return messages that were compressed one by one; all by one decompressor, as making it takes most of the time."""
    packed = messages.messages()
    sizes = [frame_content_size(each) for each in packed]  # -1 where a frame does not tell
    for each, size in zip(packed, sizes, strict=True):
        check_piece(len(each), size, "a message")
    check_piece(int(messages.size.sum()), sum(sizes), f"a block of {len(packed)} messages")
    whole: Any
    if min(sizes, default=0) < 0:
        whole = [unpack_message(each) for each in packed]
    else:
        segments = np.column_stack([messages.start, messages.size]).astype("<u8").tobytes()
        whole = ZstdDecompressor().multi_decompress_to_buffer(BufferWithSegments(messages.block.data, segments))
    return RawMessages.of(messages.connection, messages.recorded_ns, list(whole))


def _gather(
    messages: Iterator[tuple[Connection, int, bytes]], position: Mapping[int, int], size: float
) -> Iterator[tuple[RawMessages, int]]:
    """Yield messages that come one by one as blocks."""
    numbers: list[int] = []
    times: list[int] = []
    gathered: list[bytes] = []
    bytes_gathered = 0
    for connection, recorded_ns, message in messages:
        numbers.append(position[connection.id])
        times.append(recorded_ns)
        gathered.append(message)
        bytes_gathered += len(message)
        if len(gathered) == COUNT or bytes_gathered > _BYTES:
            yield RawMessages.of(numbers, times, gathered), round(size * len(gathered))
            numbers, times, gathered, bytes_gathered = [], [], [], 0
    if gathered:
        yield RawMessages.of(numbers, times, gathered), round(size * len(gathered))
