"""Damage of bags is noticed: changed in one byte, they are refused or give the same numbers."""

import random

import numpy as np
import pytest
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader

from tam_calibration.files import read_recording, write_recording
from tam_calibration.files.bag_writing import TYPESTORE, BlockWriter
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording

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


def make(folder, kind):
    """Write the recording as a bag of that kind, and return its path."""
    name, compression = KINDS[kind]
    plain = folder / ("run.mcap" if name == "run.mcap" else "plain")
    write_recording(plain, small_recording())
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


def values_of(recording):
    """Return the numbers of a recording as bytes."""
    return [np.asarray(values).tobytes() for values in (recording.time_s, recording.readings_T, recording.scalar_T)]


@pytest.mark.parametrize("kind", KINDS)
def test_a_changed_byte_is_noticed_or_changes_nothing(tmp_path, kind):
    """Wherever it lies: no damaged bag gives other numbers."""
    path = make(tmp_path, kind)
    whole = values_of(read_recording(path))
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
        try:
            assert values_of(read_recording(path)) == whole, f"seed {seed}: {file.name}, byte {place} ^ {change}"
        except InputError:
            refused += 1
        file.write_bytes(content)
    assert refused > CHANGES // 2
    assert values_of(read_recording(path)) == whole
