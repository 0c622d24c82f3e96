"""Bags to measure with."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin, Writer

from tam_calibration.model.recording import Recording
from tam_calibration.recordings.bag_writing import TYPESTORE

RATE_HZ = 100
START_S, DAY_S = 1.7e9, 86_400.0
STORAGES = {
    "sqlite3": (StoragePlugin.SQLITE3, CompressionMode.NONE),
    "sqlite3, zstd by file": (StoragePlugin.SQLITE3, CompressionMode.FILE),
    "sqlite3, zstd by message": (StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "mcap": (StoragePlugin.MCAP, CompressionMode.NONE),
    "mcap, zstd by chunk": (StoragePlugin.MCAP, CompressionMode.STORAGE),
    "mcap, zstd by file": (StoragePlugin.MCAP, CompressionMode.FILE),
}


def make_recording(samples: int, scalar: bool = True, seed: int = 1) -> Recording:
    """Return readings in all directions, four sensors, 1 nT of noise; each seed a day of its own."""
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(samples, 1, 3))
    field = 5e-5 * direction / np.linalg.norm(direction, axis=2, keepdims=True)
    readings = field + 1e-9 * rng.normal(size=(samples, 4, 3))
    intensity = 5e-5 + 1e-10 * rng.normal(size=samples) if scalar else None
    return Recording(START_S + DAY_S * seed + np.arange(samples) / RATE_HZ, readings, intensity)


def copy(source: Path, path: Path, storage: StoragePlugin, compression: CompressionMode) -> None:
    """Write the messages of a bag one by one in another storage."""
    writer = Writer(path, version=9, storage_plugin=storage)
    writer.set_compression(compression, CompressionFormat.ZSTD)
    with Reader(source) as reader, writer:
        copies = {
            each.id: writer.add_connection(each.topic, each.msgtype, typestore=TYPESTORE) for each in reader.connections
        }
        for connection, recorded_ns, message in reader.messages():
            writer.write(copies[connection.id], recorded_ns, message)
