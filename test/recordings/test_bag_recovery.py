"""What a recorder left unfinished: every whole message is recovered, and nothing else."""

import random
import shutil
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory

import bag_recorder
import pytest
from bag_recorder import STORE, TEXT, TOPICS, message
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import bag_mcap
from tam_calibration.recordings.bag_reader import open_bag, raw_messages
from tam_calibration.recordings.bag_storages import written
from tam_calibration.recordings.bag_writing import BlockWriter, recover

RECORDER = Path(bag_recorder.__file__)

LEAST = {
    "rosbags mcap": 3_000,
    "own mcap": 3_000,
    "WAL": 700,
    "DELETE": 700,
}
"""Messages of 12 000 that each kind of recorder has on disk at the least: what it holds back otherwise is its own."""


def read_plainly(path):
    """Return topic, time and bytes of all messages of a finished bag, by rosbags alone."""
    with Reader(path) as reader:
        return [(one.topic, recorded_ns, bytes(content)) for one, recorded_ns, content in reader.messages()]


def check_prefix(found, least=1):
    """Check that messages are the first that were sent, byte for byte; return how many."""
    assert found == [message(number) for number in range(len(found))]
    assert len(found) >= least
    return len(found)


def contents(path):
    """Return the names and bytes of all files of a bag."""
    return {file.name: file.read_bytes() for file in (path.iterdir() if path.is_dir() else [path])}


def seeded():
    """Return a source of random numbers whose seed is printed."""
    seed = random.SystemRandom().randrange(1 << 32)
    print(f"seed {seed}")
    return random.Random(seed)


@pytest.mark.parametrize("kind", LEAST)
def test_what_a_killed_recorder_left_is_recovered(tmp_path, kind):
    """A prefix of what was sent, in a clean bag that rosbags reads; the input is as it was."""
    path, new = tmp_path / "bag", tmp_path / "new"
    most = 12_000 + seeded().randrange(2_000)
    command = [sys.executable, RECORDER, kind, path, str(most)]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        process.kill()
    before = contents(path)
    assert "metadata.yaml" not in before
    found = recover(path, new)
    assert check_prefix(read_plainly(new), LEAST[kind]) == found.messages
    assert found.last_ns == message(found.messages - 1)[1]
    assert contents(path) == before


def test_what_no_transaction_ended_is_not_recovered(tmp_path):
    """The writer of rosbags ends its only one with the file: SQLite has nothing, which is said in one sentence."""
    command = [sys.executable, RECORDER, "rosbags sqlite3", tmp_path / "bag", "4000"]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        process.stdout.readline()
        process.kill()
    with pytest.raises(InputError, match="no message in it is complete"):
        recover(tmp_path / "bag", tmp_path / "new")


def finished(path, kind, numbers=range(1_000)):
    """Write messages to a bag, and return its data file."""
    storage, compression = kind
    path.parent.mkdir(exist_ok=True)
    writer = BlockWriter(path, storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        connections = {topic: writer.add_connection(topic, TEXT, typestore=STORE) for topic in TOPICS}
        for number in numbers:
            topic, *rest = message(number)
            writer.write(connections[topic], *rest)
    return next(file for file in path.iterdir() if file.name.startswith("bag."))


KINDS = [
    ("mcap", CompressionMode.NONE),
    ("mcap", CompressionMode.FILE),
    ("mcap", CompressionMode.MESSAGE),
    ("mcap", CompressionMode.STORAGE),
    ("sqlite3", CompressionMode.NONE),
    ("sqlite3", CompressionMode.FILE),
    ("sqlite3", CompressionMode.MESSAGE),
]


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_of_a_file_that_was_cut_the_beginning_is_read(tmp_path, kind, caplog):
    """At random places: a prefix, with a warning, the longer the later; never a message that was not sent."""
    file = finished(tmp_path / "bag", kind)
    whole, draw, counts = file.read_bytes(), seeded(), []
    for place in sorted(draw.randrange(len(whole)) for _ in range(5)):
        file.write_bytes(whole[:place])
        caplog.clear()
        try:
            with open_bag(file.parent) as reader:
                found = [(one.topic, *rest) for one, *rest in raw_messages(reader, reader.connections)]
        except InputError as problem:
            assert "no message in it is complete" in str(problem)
            counts.append(0)
            continue
        counts.append(check_prefix(found))
        assert f"left unfinished: {len(found)} complete messages are recovered, the recording ends at" in caplog.text
    assert counts == sorted(counts)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_of_a_file_that_lost_its_last_byte_nearly_all_is_read(tmp_path, kind):
    """Of a file that is packed as a whole all blocks but the last."""
    file = finished(tmp_path / "bag", kind)
    file.write_bytes(file.read_bytes()[:-1])
    with open_bag(file.parent) as reader:
        found = [(one.topic, *rest) for one, *rest in raw_messages(reader, reader.connections)]
    check_prefix(found, 100 if kind[1] is CompressionMode.FILE else 980)


@pytest.mark.parametrize("kind", KINDS, ids=str)
def test_a_bag_without_metadata_is_read_all_the_same(tmp_path, kind, caplog):
    """All of its messages, packed or not."""
    file = finished(tmp_path / "bag", kind)
    (file.parent / "metadata.yaml").unlink()
    with open_bag(file.parent) as reader:
        found = [(one.topic, *rest) for one, *rest in raw_messages(reader, reader.connections)]
    assert check_prefix(found) == 1_000
    assert "1000 complete messages are recovered" in caplog.text


@pytest.mark.parametrize("storage", written())
def test_of_several_files_the_last_may_be_unfinished(tmp_path, storage):
    """They follow each other by their numbers, the tenth behind the ninth."""
    bag = tmp_path / "bag"
    bag.mkdir()
    for part in range(11):
        file = finished(
            tmp_path / f"{part}" / "bag", (storage, CompressionMode.NONE), range(100 * part, 100 * part + 100)
        )
        shutil.move(file, bag / f"bag_{part}{file.suffix}")
    last = bag / f"bag_10{file.suffix}"
    last.write_bytes(last.read_bytes()[: last.stat().st_size * 2 // 3])
    recover(bag, tmp_path / "new")
    assert 1_000 <= check_prefix(read_plainly(tmp_path / "new")) < 1_100


def test_a_damaged_message_is_left_out_and_told(tmp_path):
    """Where its CRC tells; all that stand behind it are recovered."""
    file = finished(tmp_path / "bag", ("sqlite3", CompressionMode.NONE))
    content = file.read_bytes()
    place = content.index(message(500)[2])
    file.write_bytes(content[: place + 20] + b"?" + content[place + 21 :])
    found = recover(file.parent, tmp_path / "new")
    assert found.faults == ("message 501 is damaged",)
    assert read_plainly(tmp_path / "new") == [message(number) for number in range(1_000) if number != 500]


@pytest.mark.parametrize("part", [0.3, 0.6, 0.9])
def test_room_that_was_never_written_to_holds_no_message(tmp_path, monkeypatch, part):
    """Zeros, as a file system leaves them after a power cut: neither they nor the message that ends in them count."""
    monkeypatch.setattr(bag_mcap, "crc32", lambda content, before=0: 0)  # as of a file without CRC
    file = finished(tmp_path / "bag", ("mcap", CompressionMode.NONE))
    content = file.read_bytes()
    place = int(len(content) * part)
    for begin in (place, place + 1, place + 40):
        file.write_bytes(content[:begin] + bytes(len(content) - begin))
        found = recover(file.parent, tmp_path / f"{begin}")
        assert check_prefix(read_plainly(tmp_path / f"{begin}"), 100) == found.messages


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_nothing_but_sentences_comes_of_any_file(material, data):
    """Whatever stands in an mcap file or a database: messages, or one sentence."""
    name, content = data.draw(st.sampled_from(sorted(material.items())))
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(content)))
        patch = data.draw(st.binary(max_size=12))
        keeps = data.draw(st.booleans())
        content = content[:place] + patch + content[place + len(patch) * keeps :]
    with TemporaryDirectory() as folder:
        file = Path(folder, name)
        file.write_bytes(content)
        for look in (lambda: open_and_read(file), lambda: recover(file, Path(folder, "new"))):
            with suppress(InputError):
                look()


@pytest.fixture(scope="module")
def material(tmp_path_factory):
    """Return small files of each storage by names of their own."""
    folder = tmp_path_factory.mktemp("material")
    files = {
        storage: finished(folder / storage / "bag", (storage, CompressionMode.NONE), range(30)) for storage in written()
    }
    return {f"{storage}{file.suffix}": file.read_bytes() for storage, file in files.items()}


def open_and_read(path):
    """Read all messages of a bag."""
    with open_bag(path) as reader:
        return list(raw_messages(reader, reader.connections))
