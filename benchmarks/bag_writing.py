"""Speed of writing bags of corrected data, over making, serialising and writing a message after another."""

import itertools
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import numpy as np
from bag_making import RATE_HZ, START_S
from numpy.typing import NDArray
from rosbags.rosbag2 import StoragePlugin, Writer
from spread import Row, measure

from tam_calibration.correction.parts import Corrected
from tam_calibration.messages.point_cloud import (
    FIELD_GRADIENT_COLUMNS,
    FRAME_ID,
    GRADIENT_DIMENSIONS,
    GRADIENT_ROW_MAJOR,
    center_covariance,
    field_offsets,
)
from tam_calibration.recordings.bag_writing import TYPESTORE
from tam_calibration.results import write_corrected_pieces


def writing(folder: Path, samples: int, repeats: int) -> Iterator[Row]:
    """Yield how many times faster corrected data are written than message by message."""
    outputs = 5e-5 * np.random.default_rng(2).normal(size=(samples, 9))
    corrected = Corrected(START_S + np.arange(samples) / RATE_HZ, outputs, np.full(9, 1e-9))
    stamps_ns = int(START_S) * 10**9 + np.arange(samples) * (10**9 // RATE_HZ)
    for case, (storage, suffix) in {
        "sqlite3": (StoragePlugin.SQLITE3, ""),
        "mcap": (StoragePlugin.MCAP, ".mcap"),
    }.items():
        paths = (folder / f"written_{case}_{number}{suffix}" for number in itertools.count())
        times = measure(
            {
                "one by one": partial(write_one_by_one, paths, corrected, stamps_ns, storage),
                "ours": partial(write_ours, paths, corrected, stamps_ns),
            },
            repeats,
        )
        yield Row(case, "writing one by one over writing", list(times["one by one"] / times["ours"]), 5)


def write_ours(paths: Iterator[Path], corrected: Corrected, stamps_ns: NDArray[np.int64]) -> None:
    """Write corrected data as ``tam correct`` does."""
    write_corrected_pieces(next(paths), [(corrected, stamps_ns)])


def write_one_by_one(
    paths: Iterator[Path], corrected: Corrected, stamps_ns: NDArray[np.int64], storage: StoragePlugin
) -> None:
    """Make an object of each message, serialise and write it, with rosbags alone."""
    types = TYPESTORE.types
    dimension, point_field = types["std_msgs/msg/MultiArrayDimension"], types["sensor_msgs/msg/PointField"]
    layout = types["std_msgs/msg/MultiArrayLayout"]([dimension(*each) for each in GRADIENT_DIMENSIONS], 0)
    fields = [point_field(name, offset, 8, 1) for name, offset in field_offsets(FIELD_GRADIENT_COLUMNS)]
    covariance = center_covariance(corrected.standard_errors)
    names = {
        "/center": "sensor_msgs/msg/MagneticField",
        "/gradient": "std_msgs/msg/Float64MultiArray",
        "/field_gradient": "sensor_msgs/msg/PointCloud2",
    }
    with Writer(next(paths).with_suffix(""), version=9, storage_plugin=storage) as writer:
        connections = [(writer.add_connection(*each, typestore=TYPESTORE), each[1]) for each in names.items()]
        for stamp_ns, outputs in zip(stamps_ns.tolist(), corrected.outputs, strict=True):
            time = types["builtin_interfaces/msg/Time"](*divmod(stamp_ns, 10**9))
            header = types["std_msgs/msg/Header"](time, FRAME_ID)
            data = np.concatenate([outputs, corrected.standard_errors]).view(np.uint8)
            vector = types["geometry_msgs/msg/Vector3"](*outputs[:3].tolist())
            messages = (
                types[names["/center"]](header, vector, covariance),
                types[names["/gradient"]](layout, outputs[list(GRADIENT_ROW_MAJOR)]),
                types[names["/field_gradient"]](header, 1, 1, fields, False, len(data), len(data), data, True),
            )
            for (connection, name), message in zip(connections, messages, strict=True):
                writer.write(connection, stamp_ns, TYPESTORE.serialize_cdr(message, name))
