"""Blocks of many messages: what they hold, and the recording of them, is what single messages give."""

import shutil
import sqlite3
from contextlib import closing
from itertools import chain
from random import Random

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal, assert_array_max_ulp
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from small_chunks import cut_chunks
from zstandard import ZstdCompressor

from tam_calibration.messages import cdr
from tam_calibration.messages.cdr import RawMessages
from tam_calibration.messages.synchroniser import Synchroniser
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import (
    bag_mcap,
    bag_source,
    bag_sqlite3,
    bag_storages,
    read_pieces,
    read_samples,
)
from tam_calibration.recordings.bag_reader import open_bag, raw_blocks, raw_messages
from tam_calibration.recordings.bag_source import BagSource
from tam_calibration.recordings.bag_writing import BlockWriter
from tam_calibration.recordings.choice import choose, resolve
from tam_calibration.recordings.joining import PATIENCE_NS

STORE = get_typestore(Stores.ROS2_JAZZY)
FIELD, FLOAT64, TEXT = "sensor_msgs/msg/MagneticField", "std_msgs/msg/Float64", "std_msgs/msg/String"
IMU, TEMPERATURE = "sensor_msgs/msg/Imu", "sensor_msgs/msg/Temperature"
START_NS = 1_700_000_000_123_456_789
PERIOD_NS = 10_000_000

STORAGES = [
    ("sqlite3", CompressionMode.NONE),
    ("sqlite3", CompressionMode.FILE),
    ("sqlite3", CompressionMode.MESSAGE),
    ("mcap", CompressionMode.NONE),
    ("mcap", CompressionMode.FILE),
    ("mcap", CompressionMode.MESSAGE),
    ("mcap", CompressionMode.STORAGE),
]


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Cut blocks, chunks and batches so small that a bag of some hundred samples has many of each."""
    cut_chunks(monkeypatch, 4_000)
    monkeypatch.setattr(bag_sqlite3, "ROWS", 57)
    monkeypatch.setattr(cdr, "COUNT", 57)
    monkeypatch.setattr(bag_source, "BATCH", 400)


def make(msgtype, *values):
    """Make a message of rosbags."""
    return STORE.types[msgtype](*values)


def vector(x, y, z):
    """Make a vector."""
    return make("geometry_msgs/msg/Vector3", x, y, z)


def rough_messages(count=300, seed=3):
    """Make (topic, type, recorded_ns, bytes) of three sensors and all channels, as rough as recordings are.

    Stamps jitter, some are lost, repeated or late; the frame's name and the byte order change; the times of recording
    are not in order; the current has no stamp; a camera's text stands between.
    """
    random, messages = Random(seed), []

    def record(topic, msgtype, stamp_ns, *values):
        fate = random.random()
        recorded_ns = stamp_ns + random.randint(0, 9_900_000)
        stamp_ns += random.randint(0, 400_000) - 12_000_000 * (fate > 0.99)
        header = (
            make(
                "std_msgs/msg/Header",
                make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9)),
                topic[: random.choice((0, 3, 8))],
            ),
        )
        message = make(msgtype, *(header if msgtype not in (FLOAT64, TEXT) else ()), *values)
        data = bytes(STORE.serialize_cdr(message, msgtype, little_endian=random.random() < 0.9))
        for _ in range(0 if fate < 0.02 else 2 if fate < 0.04 else 1):
            messages.append((f"/auv/{topic}", msgtype, recorded_ns, data))

    none = np.array([-1.0, *[0.0] * 8])
    for index in range(count):
        stamp_ns = START_NS + index * PERIOD_NS
        for sensor in (1, 2, 3):
            record(
                f"tam_{sensor}/magnetic_field",
                FIELD,
                stamp_ns,
                vector(*np.random.default_rng(index).normal(size=3)),
                none,
            )
        record("scalar/intensity", FIELD, stamp_ns, vector(1 + random.random(), random.random(), random.random()), none)
        record("current", FLOAT64, stamp_ns, random.random())
        if index % 7 == 0:
            quaternion = make("geometry_msgs/msg/Quaternion", *(random.random() for _ in range(4)))
            covariance = none if index % 3 == 0 else np.zeros(9)
            turning, still = vector(0.1, 0.2, random.random()), vector(0.0, 0.0, 0.0)
            of_rates = none if index % 5 == 0 else np.zeros(9)
            record("imu/data", IMU, stamp_ns, quaternion, covariance, turning, of_rates, still, none)
            record("temperature", TEMPERATURE, stamp_ns, random.random(), 0.0)
            record("camera", TEXT, stamp_ns, "picture " * random.randint(0, 200))
    return messages


def write(path, messages, storage="sqlite3", compression=CompressionMode.NONE, as_block=False, writer=None):
    """Write a bag, message by message or as one block; by default with our writer."""
    writer = writer or BlockWriter(path, storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        kinds = dict.fromkeys((topic, msgtype) for topic, msgtype, _, _ in messages)
        connections = {topic: writer.add_connection(topic, msgtype, typestore=STORE) for topic, msgtype in kinds}
        if as_block:
            numbers = [connections[topic].id for topic, *_ in messages]
            writer.write_block(RawMessages.of(numbers, [one[2] for one in messages], [one[3] for one in messages]))
        else:
            for topic, _, recorded_ns, data in messages:
                writer.write(connections[topic], recorded_ns, data)
    return path


def split(path, messages, storage):
    """Write a bag of two files."""
    half = len(messages) // 2
    write(path, messages[:half], storage)
    second = write(path.with_name("second"), messages[half:], storage)
    data = next(second.glob("second.*"))
    shutil.move(data, path / data.name)
    with Reader(path) as reader:
        count = reader.message_count
    metadata = yaml.safe_load((path / "metadata.yaml").read_text())
    information = metadata["rosbag2_bagfile_information"]
    information["relative_file_paths"].append(data.name)
    information["message_count"] = count + len(messages) - half
    for topic in information["topics_with_message_count"]:
        name = topic["topic_metadata"]["name"]
        topic["message_count"] = sum(one[0] == name for one in messages)
    (path / "metadata.yaml").write_text(yaml.safe_dump(metadata))
    return path


def read_plainly(path, tolerance_ns=0):
    """Return stamps, values and losses in words, each message made an object by rosbags and pushed by itself."""
    with open_bag(path) as own:
        source = BagSource(own)
        topics = resolve(source, choose(source, None).channel_map)
    with Reader(path) as reader:
        synchroniser = Synchroniser(
            topics.layout,
            tolerance_ns,
            PATIENCE_NS,
            PATIENCE_NS,
            scalar_is_held=topics.scalar_is_held,
            expected=topics.layout.channels,
        )
        streams = {}
        for stream, wanted in topics.wanted.items():
            streams.setdefault(wanted.table.name, []).append(stream)
        samples = []
        for connection, _, raw in reader.messages([one for one in reader.connections if one.topic in streams]):
            message = STORE.deserialize_cdr(raw, connection.msgtype)
            for stream in streams[connection.topic]:
                samples += synchroniser.push(stream, stamp_of(message), values_of(stream, message))
        samples += synchroniser.flush()
    rows = np.array([(one.stamp_ns / 10**9, *one.values) for one in samples])
    return [one.stamp_ns for one in samples], topics.layout.recording(rows), synchroniser.explain_losses()


def stamp_of(message):
    """Return the stamp of a message that has one."""
    return message.header.stamp.sec * 10**9 + message.header.stamp.nanosec if hasattr(message, "header") else None


def values_of(stream, message):
    """Return the values of a message as the columns of its stream hold them."""
    if hasattr(message, "magnetic_field"):
        field = message.magnetic_field
        norm = (field.x * field.x + field.y * field.y + field.z * field.z) ** 0.5
        return (norm,) if stream == "scalar" else (field.x, field.y, field.z)
    if stream == "gyroscope":
        rates, has_none = message.angular_velocity, message.angular_velocity_covariance[0] == -1
        return (np.nan,) * 3 if has_none else (rates.x, rates.y, rates.z)
    if hasattr(message, "orientation"):
        turn, has_none = message.orientation, message.orientation_covariance[0] == -1
        return (np.nan,) * 4 if has_none else (turn.x, turn.y, turn.z, turn.w)
    return (message.temperature if hasattr(message, "temperature") else message.data,)


def check_equal(samples, plain):
    """Check that samples have the stamps, values and channels of a plain reading."""
    stamps, recording, _ = plain
    assert samples.stamps_ns.tolist() == stamps
    assert list(samples.recording.values()) == list(recording.values())
    for name, value in recording.values().items():
        assert_array_max_ulp(samples.recording.values()[name], value, maxulp=1)
    assert_array_equal(samples.recording.time_s, recording.time_s)
    assert_array_equal(samples.recording.readings_T, recording.readings_T)


@pytest.mark.parametrize(
    ("storage", "compression", "as_block"),
    [
        *((storage, compression, False) for storage, compression in STORAGES),
        *((storage, CompressionMode.NONE, True) for storage in bag_storages.written()),
    ],
)
def test_a_bag_reads_as_message_by_message(tmp_path, caplog, storage, compression, as_block):
    """Bitwise the same stamps and readings, and the same losses in words, however the bag is stored and was written."""
    path = write(tmp_path / "bag", rough_messages(), storage, compression, as_block)
    plain = read_plainly(path)
    check_equal(read_samples(path), plain)
    assert plain[2] in caplog.text and "missing" in plain[2] and "out of order" in plain[2]


@pytest.mark.parametrize("compression", [CompressionMode.NONE, CompressionMode.STORAGE])
def test_a_block_makes_the_mcap_file_of_rosbags(tmp_path, monkeypatch, compression):
    """Byte for byte, but for the CRCs, that of its messages one by one; of several chunks."""
    monkeypatch.undo()  # chunks of the usual size
    monkeypatch.setattr(bag_mcap, "crc32", lambda *content: 0)
    monkeypatch.setattr(bag_mcap, "seal", lambda path: None)
    messages = 20 * rough_messages()
    ours = write(tmp_path / "ours" / "bag", messages, "mcap", compression, as_block=True)
    plain = Writer(tmp_path / "plain" / "bag", version=9, storage_plugin=StoragePlugin.MCAP)
    theirs = write(tmp_path / "plain" / "bag", messages, "mcap", compression, writer=plain)
    assert (theirs / "bag.mcap").stat().st_size > (1 << 20 if compression is CompressionMode.NONE else 0)
    assert (ours / "bag.mcap").read_bytes() == (theirs / "bag.mcap").read_bytes()
    assert (ours / "metadata.yaml").read_text() == (theirs / "metadata.yaml").read_text()


@pytest.mark.parametrize("storage", bag_storages.written())
def test_a_split_bag_reads_as_message_by_message(tmp_path, storage):
    """The files of a bag follow each other; samples go across."""
    path = split(tmp_path / "bag", sorted(rough_messages(), key=lambda one: one[2]), storage)
    plain = read_plainly(path)
    assert len(plain[0]) > 200
    check_equal(read_samples(path), plain)


@pytest.mark.parametrize("storage", bag_storages.written())
@pytest.mark.parametrize("recorded", ["as it came", "all at once"])
def test_blocks_hold_the_messages_in_the_order_of_the_bag(tmp_path, storage, recorded):
    """Also where chunks overlap in time, where a topic is left out, and where sizes differ from message to message."""
    messages = [(*one[:2], one[2] if recorded == "as it came" else 5, one[3]) for one in rough_messages()]
    path = write(tmp_path / "bag", messages, storage, as_block=True)
    with Reader(path) as reader:
        wanted = [one for one in reader.connections if one.topic != "/auv/current"]
        single = [(wanted.index(one), time, bytes(data)) for one, time, data in reader.messages(wanted)]
        topics = [one.topic for one in wanted]
    with open_bag(path) as reader:
        wanted = sorted(
            (one for one in reader.connections if one.topic in topics), key=lambda one: topics.index(one.topic)
        )
        ours = [(wanted.index(one), time, data) for one, time, data in raw_messages(reader, wanted)]
        blocks = list(raw_blocks(reader, wanted))
    assert ours == single
    assert len(blocks) > (5 if recorded == "as it came" or storage == "mcap" else 0)
    rows = [zip(b.connection.tolist(), b.recorded_ns.tolist(), b.messages(), strict=True) for b in blocks]
    assert list(chain.from_iterable(rows)) == single


@pytest.mark.parametrize("storage", bag_storages.written())
def test_pieces_make_up_the_whole(tmp_path, storage):
    """The pieces follow each other without a sample lost or doubled; a piece without a channel lacks it alone."""
    path = write(tmp_path / "bag", rough_messages(), storage, as_block=True)
    whole, parts = read_samples(path), list(read_pieces(path))
    assert len(parts) > 3
    assert_array_equal(np.concatenate([part.stamps_ns for part in parts]), whole.stamps_ns)
    for name in ("time_s", "readings_T", "scalar_T", "current_A", "temperature_C"):
        again = np.concatenate([getattr(part.recording, name) for part in parts])
        assert_array_equal(again, getattr(whole.recording, name))


@pytest.mark.parametrize("storage", bag_storages.written())
def test_a_block_is_written_as_single_messages_are(tmp_path, storage):
    """Contents, counts and times that readers of the bag see are the same."""
    messages = sorted(rough_messages(), key=lambda one: one[2])
    seen = []
    for as_block in (False, True):
        with Reader(write(tmp_path / str(as_block), messages, storage, as_block=as_block)) as reader:
            counts = {one.topic: one.msgcount for one in reader.connections}
            of_file = {one.topic: one.msgcount for one in reader.storage.storages[0].connections}
            assert counts == of_file
            content = [(one.topic, time, bytes(data)) for one, time, data in reader.messages()]
            seen.append((counts, reader.message_count, reader.start_time, reader.end_time, content))
    assert seen[0] == seen[1]


def test_an_index_that_does_not_fit_is_refused(tmp_path, monkeypatch):
    """An index of messages that points elsewhere is damage, not data, also where no CRC tells."""
    monkeypatch.setattr(bag_mcap, "seal", lambda path: None)
    path = write(tmp_path / "bag", rough_messages(), "mcap", as_block=True)
    data = path / "bag.mcap"
    with Reader(path) as reader:
        chunk = reader.storage.storages[0].chunks[3]
    content = bytearray(data.read_bytes())
    place = next(iter(chunk.message_index_offsets.values())) + 15 + 8
    content[place] ^= 3
    data.write_bytes(bytes(content))
    with pytest.raises(InputError, match="is damaged or truncated: the index of a chunk does not fit the chunk"):
        read_samples(path)


def test_an_mcap_file_without_index_reads_alike(tmp_path, caplog):
    """A file that ends without a summary is whole: its messages come one by one, without a warning of its end."""
    path = write(tmp_path / "bag", sorted(rough_messages(), key=lambda one: one[2]), "mcap")
    plain = read_plainly(path)
    content = (path / "bag.mcap").read_bytes()
    data_end = int.from_bytes(content[-28:-20], "little")
    (path / "bag.mcap").write_bytes(content[:data_end] + b"\x02\x14" + bytes(27) + b"\x89MCAP0\r\n")
    check_equal(read_samples(path), plain)
    assert "unfinished" not in caplog.text


def test_a_database_without_index_reads_alike(tmp_path):
    """Where nothing puts rows in the order of recording the messages come one by one."""
    path = write(tmp_path / "bag", rough_messages())
    plain = read_plainly(path)
    with closing(sqlite3.connect(path / "bag.db3")) as database:
        database.execute("DROP INDEX timestamp_idx")
    check_equal(read_samples(path), plain)


def test_compressed_messages_need_not_tell_their_size(tmp_path, monkeypatch):
    """A frame of zstd may leave out how long its content is."""
    compressor = ZstdCompressor(write_content_size=False)
    monkeypatch.setattr("rosbags.rosbag2.writer.zstd.compress", compressor.compress)
    path = write(tmp_path / "bag", rough_messages(), "sqlite3", CompressionMode.MESSAGE)
    check_equal(read_samples(path), read_plainly(path))


def test_a_damaged_compressed_message_is_refused(tmp_path):
    """A message that cannot be unpacked is damage."""
    path = write(tmp_path / "bag", rough_messages(), "sqlite3", CompressionMode.MESSAGE)
    with closing(sqlite3.connect(path / "bag.db3")) as database, database:
        database.execute("UPDATE messages SET data = substr(data, 1, 40), crc32 = NULL WHERE id = 99")
    with pytest.raises(InputError, match="is damaged or truncated: "):
        read_samples(path)
