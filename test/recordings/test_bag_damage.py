"""Damage of bags is noticed: changed in one byte, they are refused or give the same numbers."""

import random
import re
import resource
import sqlite3
import struct
from contextlib import closing, contextmanager
from tempfile import gettempdir
from zlib import crc32

import numpy as np
import pytest
import yaml
from numpy.testing import assert_array_equal
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader
from small_chunks import cut_chunks

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import bag_mcap, bag_reader, bag_writing, read_recording
from tam_calibration.recordings.bag_writing import TYPESTORE, BlockWriter
from tam_calibration.results import write_recording

CHANGES = 60
"""Bytes that are changed, one after another, of each kind of bag."""

KINDS = {
    "single mcap file": ("run.mcap", None),
    "mcap": ("mcap", None),
    "sqlite3": ("sqlite3", None),
    "sqlite3, zstd by file": ("sqlite3", CompressionMode.FILE),
    "sqlite3, zstd by message": ("sqlite3", CompressionMode.MESSAGE),
    "mcap, zstd by file": ("mcap", CompressionMode.FILE),
    "mcap, zstd by chunk": ("mcap", CompressionMode.STORAGE),
}


def small_recording(samples=60):
    """Make a recording of two sensors with scalar and current, so that times of recording matter too."""
    rng = np.random.default_rng(3)
    readings = 5e-5 * rng.normal(size=(samples, 2, 3))
    return Recording(1.7e9 + np.arange(samples) / 64, readings, 5e-5 + 1e-9 * rng.normal(size=samples))


def make(folder, kind, samples=60):
    """Write the recording as a bag of that kind, and return its path."""
    name, compression = KINDS[kind]
    plain = folder / ("run.mcap" if name == "run.mcap" else "plain")
    write_recording(plain, small_recording(samples))
    if name == "run.mcap":
        return plain
    writer = BlockWriter(folder / "bag", name)
    writer.set_compression(compression or CompressionMode.NONE, CompressionFormat.ZSTD)
    with Reader(plain) as reader, writer:
        ids = {
            each.topic: writer.add_connection(each.topic, each.msgtype, typestore=TYPESTORE)
            for each in reader.connections
        }
        for connection, recorded_ns, message in reader.messages():
            writer.write(ids[connection.topic], recorded_ns, message)
    return folder / "bag"


def is_told_beginning(recording, whole, told):
    """Return whether a recording is the beginning of another, as a warning said."""
    beginning = whole.take(slice(recording.sample_count))
    return "the recording was left unfinished" in told and values_of(recording) == values_of(beginning)


def values_of(recording):
    """Return the numbers of a recording as bytes."""
    return [np.asarray(values).tobytes() for values in (recording.time_s, recording.readings_T, recording.scalar_T)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_byte_is_noticed_or_changes_nothing(tmp_path, caplog, kind):
    """Wherever it lies: no damaged bag gives other numbers; one that seems cut gives its beginning, with a warning."""
    path = make(tmp_path, kind)
    whole = read_recording(path)
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    seed = random.SystemRandom().randrange(1 << 32)
    print(f"seed {seed}")
    draw = random.Random(seed)
    refused = 0
    for _ in range(CHANGES):
        file = draw.choices(files, [each.stat().st_size for each in files])[0]
        content = file.read_bytes()
        place, change = draw.randrange(len(content)), draw.randrange(1, 256)
        file.write_bytes(content[:place] + bytes([content[place] ^ change]) + content[place + 1 :])
        bag_reader._opened.cache_clear()  # two changes may fall into one tick of the file system's clock
        caplog.clear()
        try:
            found = read_recording(path)
            is_right = values_of(found) == values_of(whole) or is_told_beginning(found, whole, caplog.text)
            assert is_right, f"seed {seed}: {file.name}, byte {place} ^ {change}"
        except InputError:
            refused += 1
        file.write_bytes(content)
    assert refused > CHANGES // 4  # the others changed what nothing is read of
    bag_reader._opened.cache_clear()
    assert values_of(read_recording(path)) == values_of(whole)


@pytest.mark.parametrize(
    ("change", "problem"),
    [("serialization_format = 'c;r'", "is serialised as 'c;r', and as 'cdr'"), ("id = 92", "no file has")],
)
def test_a_topic_that_the_metadata_know_otherwise_is_damage(tmp_path, change, problem):
    """Else sensor 2 would be taken for sensor 1."""
    path = make(tmp_path, "sqlite3")
    with closing(sqlite3.connect(path / "bag.db3")) as database:
        database.execute(f"UPDATE topics SET {change} WHERE name = '/tam_1/magnetic_field'")
        database.commit()
    assert problem in refusal(path)


def spoil(file, sample, sensor):
    """Change one bit of a reading of a sensor in a file of the small recording, that of the sample with this number."""
    reading = small_recording().readings_T[sample, sensor].tobytes()
    content = file.read_bytes()
    place = content.index(reading)
    file.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])


def refusal(path):
    """Return the sentence with which a bag is refused."""
    with pytest.raises(InputError) as problem:
        read_recording(path)
    assert "\n" not in str(problem.value)
    return str(problem.value)


def test_the_damaged_message_is_named(tmp_path):
    """Of a database with number, topic and time, by its CRC."""
    path = tmp_path / "run"
    write_recording(path, small_recording(), "sqlite3")
    spoil(path / "run.db3", 32, 1)
    assert refusal(path) == (
        f"{path} is damaged or truncated: message 98 is damaged, of /tam_2/magnetic_field at 1700000000.500 s; "
        f"`tam recover {path} -o NEW` keeps the complete messages"
    )


@pytest.mark.parametrize("name", ["run.mcap", "run"])
def test_a_damaged_chunk_is_named(tmp_path, monkeypatch, name):
    """With its place and times; the other chunks are recovered."""
    cut_chunks(monkeypatch, 4_000)
    path = tmp_path / name
    write_recording(path, small_recording(), "mcap")
    spoil(path if path.is_file() else path / "run.mcap", 0, 0)
    told = refusal(path)
    assert (
        "damaged or truncated: the chunk at byte 52, recorded at 1700000000.000 s to 1700000000.094 s, is dam" in told
    )
    found = bag_writing.recover(path, tmp_path / "new")
    assert found.faults[0] in told and len(found.faults) == 1 and 60 < found.messages < 180
    assert f"{found.messages} complete messages are recovered" in str(found) and found.faults[0] in str(found)
    again = read_recording(tmp_path / "new")
    assert_array_equal(again.readings_T, small_recording().readings_T[-again.sample_count :])


def test_a_chunk_is_checked_where_only_it_has_a_crc(tmp_path, monkeypatch):
    """As in the files of ROS, which have no CRC of the data section."""
    monkeypatch.setattr(bag_mcap, "seal", lambda path: None)
    path = tmp_path / "run.mcap"
    write_recording(path, small_recording())
    assert read_recording(path).sample_count == 60
    spoil(path, 30, 0)
    assert "recorded at 1700000000.000 s to 1700000000.922 s, is damaged; `tam recover" in refusal(path)


def test_the_crcs_are_those_of_the_specification(tmp_path):
    """Of all before the record of the end of data; of the summary and the footer before its CRC."""
    path = tmp_path / "run.mcap"
    write_recording(path, small_recording())
    content = path.read_bytes()
    summary, _, summary_crc = struct.unpack("<QQI", content[-28:-8])
    assert content[summary - 13 : summary - 4] == struct.pack("<BQ", 15, 4)
    assert crc32(content[: summary - 13]) == struct.unpack("<I", content[summary - 4 : summary])[0] != 0
    assert crc32(content[summary:-12]) == summary_crc != 0
    with Reader(path) as reader:
        [chunk] = reader.storage.chunks
    head = chunk.chunk_start_offset + 9
    stored = content[head + 40 : head + 40 + chunk.uncompressed_size]
    assert crc32(stored) == int.from_bytes(content[head + 24 : head + 28], "little") != 0


def test_the_crc_of_a_message_is_of_its_topic_time_and_bytes(tmp_path):
    """As text, so that any program can compute it."""
    write_recording(tmp_path / "run", small_recording(), "sqlite3")
    with closing(sqlite3.connect(tmp_path / "run" / "run.db3")) as database:
        rows = database.execute("SELECT topic_id, timestamp, data, crc32 FROM messages").fetchall()
    assert len(rows) == 180
    assert all(crc == crc32(b"%d %d" % (topic, time) + data) for topic, time, data, crc in rows)


def test_a_topic_that_the_metadata_name_otherwise_is_not_lost_in_silence(tmp_path):
    """It is named."""
    path = tmp_path / "run"
    write_recording(path, small_recording())
    text = (path / "metadata.yaml").read_text()
    (path / "metadata.yaml").write_text(text.replace("/scalar/intensity", "/scalar/intensitx"))
    assert "the metadata count 60 messages of /scalar/intensitx, which no file has; `tam recover" in refusal(path)


def test_a_topic_that_the_metadata_do_not_name_is_read(tmp_path):
    """It is in the files."""
    path = make(tmp_path, "sqlite3")
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    topics = content["rosbag2_bagfile_information"]["topics_with_message_count"]
    del topics[[each["topic_metadata"]["name"] for each in topics].index("/scalar/intensity")]
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert_array_equal(read_recording(path).scalar_T, small_recording().scalar_T)


def test_a_sentence_names_three_faults_and_counts_the_others():
    """So that it stays a sentence."""
    told = str(bag_reader.Recovered(5, 10**9, 3 * 10**9, tuple("abcde"))).partition("after it began")[2]
    assert told == "; a; b; c; 2 faults more"


def test_of_a_packed_file_that_is_damaged_the_beginning_is_recovered(tmp_path):
    """As far as it can be unpacked, which is told."""
    path = make(tmp_path, "sqlite3, zstd by file", 2_000)
    file = next(path.glob("*.zstd"))
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2] + b"\xff" * 1000 + content[len(content) // 2 + 1000 :])
    assert f"{path} is damaged or truncated: " in refusal(path)
    found = bag_writing.recover(path, tmp_path / "new")
    assert found.faults[0] == f"{file.name} cannot be unpacked to its end"
    assert 1_000 < found.messages < 5_000


@contextmanager
def without_room():
    """Let no file grow beyond a few pages."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("kind", ["sqlite3, zstd by file", "sqlite3"])
def test_a_disk_without_room_is_no_damage(tmp_path, kind):
    """What has to be unpacked, or copied as its end is missing, says where room is missing."""
    path = make(tmp_path, kind, 2_000)
    for file in path.glob("*.db3"):
        file.write_bytes(file.read_bytes()[:-500])
    with without_room():
        told = refusal(path)
    assert f"{path} cannot be unpacked or recovered in {gettempdir()}: File too large; let TMPDIR name" in told


def test_an_unfinished_mcap_file_is_read_in_place(tmp_path):
    """It needs no room on the disk."""
    path = make(tmp_path, "single mcap file", 2_000)
    path.write_bytes(path.read_bytes()[:-500])
    with without_room():
        recording = read_recording(path)
    assert_array_equal(recording.readings_T, small_recording(2_000).readings_T)


@pytest.mark.parametrize(
    ("key", "value"),
    [("files", "on"), ("version", "x"), ("duration", "[]"), ("message_count", "many"), ("storage_identifier", "")],
)
def test_metadata_that_the_files_tell_better_do_not_matter(tmp_path, caplog, key, value):
    """Whatever stands there."""
    path = make(tmp_path, "sqlite3")
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"][key] = yaml.safe_load(value)
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert_array_equal(read_recording(path).readings_T, small_recording().readings_T)
    assert not caplog.text


@pytest.mark.parametrize("key", ["relative_file_paths", "topics_with_message_count"])
def test_metadata_that_are_none_are_as_if_they_were_not_there(tmp_path, caplog, key):
    """The messages tell enough: they are read, with a warning."""
    path = make(tmp_path, "sqlite3")
    content = yaml.safe_load((path / "metadata.yaml").read_text())
    content["rosbag2_bagfile_information"][key] = 7
    (path / "metadata.yaml").write_text(yaml.safe_dump(content))
    assert_array_equal(read_recording(path).readings_T, small_recording().readings_T)
    assert "the recording was left unfinished: 180 complete messages are recovered" in caplog.text


def test_a_topic_whose_name_is_a_date_is_told(tmp_path):
    """In the YAML of rosbags it may be one."""
    path = make(tmp_path, "sqlite3")
    metadata = path / "metadata.yaml"
    metadata.write_text(re.sub("name: /?tam_1/magnetic_field", "name: 2026-01-01", metadata.read_text()))
    assert "the metadata count 60 messages of 2026-01-01, which no file has" in refusal(path)


def test_files_of_several_recordings_are_no_bag(tmp_path):
    """A folder without metadata is what a recorder left, not what a user gathered."""
    for name in ("one_0.mcap", "one_1.mcap", "other.mcap"):
        (tmp_path / name).write_bytes(make(tmp_path, "single mcap file").read_bytes())
    (tmp_path / "run.mcap").unlink()
    assert refusal(tmp_path).endswith("files of several recordings, one and other among them: name one of them")
