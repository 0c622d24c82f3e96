"""What is packed in a bag is bounded: told in a sentence before it takes memory."""

import struct
import tracemalloc

import numpy as np
import pytest
from bag_recorder import STORE, TEXT, message
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from zstandard import ZstdCompressor

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import read_recording
from tam_calibration.recordings.bag_bounds import check_expansion, check_piece, unpack
from tam_calibration.recordings.bag_reader import open_bag, raw_messages
from tam_calibration.recordings.bag_storages import written
from tam_calibration.recordings.bag_writing import recover
from tam_calibration.results import write_recording

ZEROS = 200 << 20
"""Bytes of which a bomb is made: what is unpacked of them is measured."""

ALLOWED = 48 << 20
"""Bytes of memory that reading a bomb may take."""


@pytest.fixture(scope="module")
def bomb():
    """Return zeros that zstd has packed, which do not tell how many they are."""
    compressor = ZstdCompressor(write_content_size=False).compressobj()
    parts = [compressor.compress(bytes(1 << 20)) for _ in range(ZEROS >> 20)]
    return b"".join([*parts, compressor.flush()])


def write(path, compression, storage=StoragePlugin.MCAP):
    """Write a bag of some messages, and return its data file."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/first", TEXT, typestore=STORE)
        for number in range(0, 40, 2):
            writer.write(connection, *message(number)[1:])
    return next(file for file in path.iterdir() if file.name.startswith("bag."))


def refuse(path, sentence):
    """Check that a bag is refused in one sentence, and without the memory that it asks for."""
    tracemalloc.start()
    with pytest.raises(InputError, match=sentence) as problem, open_bag(path) as reader:
        list(raw_messages(reader, reader.connections))
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < ALLOWED
    assert str(path) in str(problem.value) and "\n" not in str(problem.value)


def chunk(packed, claimed, compression=b"zstd"):
    """Return the record of a chunk of mcap."""
    head = struct.pack("<QQQII", 0, 0, claimed, 0, len(compression)) + compression + struct.pack("<Q", len(packed))
    return struct.pack("<BQ", 6, len(head) + len(packed)) + head + packed


def write_mcap(path, records, is_finished):
    """Write an mcap file of these records, without summary."""
    header = struct.pack("<I", 4) + b"ros2" + bytes(4)
    end = struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQQQI", 2, 20, 0, 0, 0) + b"\x89MCAP0\r\n"
    path.write_bytes(
        b"\x89MCAP0\r\n" + struct.pack("<BQ", 1, len(header)) + header + records + (end if is_finished else b"")
    )


@pytest.mark.parametrize("is_finished", [False, True])
@pytest.mark.parametrize(
    ("claimed", "sentence"),
    [
        (1 << 40, f"a chunk has {1 << 40} bytes: more than {1 << 28} are not read"),
        (
            ZEROS,
            "a chunk of .* bytes unpacks to .* bytes or more: no recording is compressed by more than a factor of 1000",
        ),
        (1000, "damaged"),
    ],
)
def test_a_chunk_that_is_a_bomb_is_refused(tmp_path, bomb, claimed, sentence, is_finished):
    """Whether it tells how much comes of it or not, in a finished file or in one that is not."""
    write_mcap(tmp_path / "bomb.mcap", chunk(bomb, claimed), is_finished)
    refuse(tmp_path / "bomb.mcap", sentence)


def test_a_chunk_in_the_index_is_bounded_too(tmp_path):
    """Where reading goes by the index of an mcap file."""
    file = write(tmp_path / "bag", CompressionMode.NONE)
    content = file.read_bytes()
    head = content.index(struct.pack("<I", 10) + struct.pack("<H", 1), len(content) // 2) - 32  # one topic's place
    end = head + int.from_bytes(content[head - 8 : head], "little")
    file.write_bytes(content[: end - 8] + struct.pack("<Q", 1 << 40) + content[end:])
    refuse(tmp_path / "bag", f"a chunk has {1 << 40} bytes")


def test_a_file_that_is_a_bomb_is_refused(tmp_path, bomb):
    """While it is unpacked."""
    file = write(tmp_path / "bag", CompressionMode.FILE, StoragePlugin.SQLITE3)
    file.write_bytes(bomb)
    refuse(
        tmp_path / "bag", "bag.db3.zstd of .* bytes or more: no recording is compressed by more than a factor of 1000"
    )


@pytest.mark.parametrize("tells_size", [False, True])
def test_a_message_that_is_a_bomb_is_refused(tmp_path, monkeypatch, bomb, tells_size):
    """Whether it tells how much comes of it or not."""
    packed = ZstdCompressor().compress(bytes(ZEROS)) if tells_size else bomb
    monkeypatch.setattr("rosbags.rosbag2.writer.zstd.compress", lambda content: packed)
    write(tmp_path / "bag", CompressionMode.MESSAGE, StoragePlugin.SQLITE3)
    refuse(tmp_path / "bag", "a message of .* bytes unpacks to .* bytes or more")


def test_the_bounds_are_those_that_are_stated():
    """256 MiB a piece, 1000 bytes of one, and always 1 MiB; of LZ4 as of zstd."""
    check_piece(1 << 28, 1 << 28, "a piece")
    with pytest.raises(InputError, match="a piece has 268435457 bytes: more than 268435456 are not read"):
        check_piece(1 << 28, (1 << 28) + 1, "a piece")
    check_expansion(10_000, 10_000_000, "a piece")
    with pytest.raises(InputError, match="a piece of 10000 bytes unpacks to 10000001 bytes"):
        check_expansion(10_000, 10_000_001, "a piece")
    check_expansion(1, 1 << 20, "a piece")
    with pytest.raises(InputError, match="a piece of 1 bytes unpacks to"):
        check_expansion(1, (1 << 20) + 1, "a piece")


@pytest.mark.parametrize("compression", ["", "lz4", "zstd"])
def test_a_chunk_gives_what_it_claims_or_nothing(compression):
    """More or less is damage."""
    from lz4.frame import compress

    content = bytes(range(200)) * 20
    packed = {"": content, "lz4": compress(content), "zstd": ZstdCompressor().compress(content)}[compression]
    assert unpack(packed, compression, 4000) == content
    for size in (0, 3999, 4001):
        with pytest.raises(InputError, match=f"a chunk does not hold the {size} bytes that it claims"):
            unpack(packed, compression, size)
    with pytest.raises(InputError, match="the compression 'zip' of a chunk is not known"):
        unpack(packed, "zip", 4000)


@pytest.mark.parametrize("name", ["metadata.yaml", "bag.mcap"])
@pytest.mark.parametrize("function", [open_bag, lambda path: recover(path, path.with_name("new"))])
def test_what_is_no_file_is_refused(tmp_path, name, function):
    """A device in the place of a file of a bag is never read."""
    write(tmp_path / "bag", CompressionMode.NONE)
    (tmp_path / "bag" / name).unlink()
    (tmp_path / "bag" / name).symlink_to("/dev/zero")
    with pytest.raises(InputError, match=f"{name} is no regular file"), function(tmp_path / "bag"):
        pass


def test_metadata_that_count_too_much_take_no_memory(tmp_path):
    """Numbers of messages are what the files hold, whatever the metadata tell."""
    write_recording(tmp_path / "bag", Recording(np.arange(20.0), np.ones((20, 1, 3)) * 5e-5))
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("message_count: 20", f"message_count: {10**15}"))
    assert read_recording(tmp_path / "bag").sample_count == 20


@pytest.mark.parametrize("text", ["[" * 100_000, "a: &a [1, 1]\nb: [" + "*a, " * 1000 + "]", "no: [metadata", ""])
def test_hostile_metadata_are_left_out(tmp_path, caplog, text):
    """The messages are in the files."""
    write(tmp_path / "bag", CompressionMode.NONE)
    (tmp_path / "bag" / "metadata.yaml").write_text(text)
    with open_bag(tmp_path / "bag") as reader:
        assert reader.message_count == 20
    assert "20 complete messages are recovered" in caplog.text


@pytest.mark.parametrize("storage", written())
@pytest.mark.parametrize("is_finished", [False, True])
def test_a_topic_that_is_described_at_length_is_refused(tmp_path, monkeypatch, storage, is_finished):
    """Its quality of service is YAML, which takes long where it nests."""
    monkeypatch.setattr("rosbags.rosbag2.writer.dump_qos_v9", lambda profiles: "[" * 70_000)
    file = write(tmp_path / "bag", CompressionMode.NONE, StoragePlugin[storage.upper()])
    if not is_finished:
        file.write_bytes(file.read_bytes()[:-1])
    metadata = tmp_path / "bag" / "metadata.yaml"
    metadata.write_text(metadata.read_text().replace("[" * 70_000, ""))
    refuse(tmp_path / "bag", "a topic is described by 70.* bytes: more than 65536 are not read")
